"""What a stand-in is made from: one person or object of a model, as a field in its own frame."""

from __future__ import annotations

from typing import Protocol

import numpy as np

CHUNK = 1 << 16
"""Points that a field is asked for at once: between two chunks a job can be cancelled."""


class Part(Protocol):
    """A person in canonical space, or an object in its own frame; metres.

    Attributes:
        kind: ``person`` or ``object``; name: of the identity.
        lower, upper: [3] corners of a box outside of which nothing is.
    """

    kind: str
    name: str
    lower: np.ndarray
    upper: np.ndarray

    def holds(self, points: np.ndarray) -> np.ndarray:
        """[N] bool of points [N, 3]: where the model renders anything; elsewhere the field was never trained."""
        ...

    def density(self, points: np.ndarray, width: float) -> np.ndarray:
        """[N] float32 per metre, averaged over cubes of edge ``width`` metres where the model can."""
        ...

    def colour(self, points: np.ndarray, width: float) -> np.ndarray:
        """[N, 3] float32 sRGB in 0…1: the canonical pose's, without the learned light."""
        ...

    def weights(self, points: np.ndarray) -> np.ndarray:
        """[N, B] learned skinning weights of a person, rows sum to one; [N, 0] of an object."""
        ...
