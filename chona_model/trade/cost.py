"""What a frame costs by the rays it traces: a fixed part for its pose, and a part for every ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls


@dataclass(frozen=True)
class Cost:
    """Seconds of a frame: ``fixed`` + ``per_ray`` · rays."""

    fixed: float
    per_ray: float

    def seconds(self, rays: float) -> float:
        """Of a frame that traces so many rays."""
        return self.fixed + self.per_ray * rays


def fit_cost(rays: Sequence[float], seconds: Sequence[float]) -> Cost:
    """The cost that fits measured frames best, by relative error; neither part is negative.

    Raises:
        ValueError: no measurements.
    """
    if not rays:
        raise ValueError("no frame was measured")
    weights = 1.0 / np.asarray(seconds, dtype=np.float64)
    rows = np.stack([np.ones(len(rays)), np.asarray(rays, dtype=np.float64)], axis=-1) * weights[:, None]
    # Columns of like size, or rays in their thousands drown the fixed part.
    scale = np.maximum(np.abs(rows).max(axis=0), 1e-300)
    solution, _ = nnls(rows / scale, np.ones(len(rays)))
    fixed, per_ray = solution / scale
    return Cost(float(fixed), float(per_ray))
