"""Where objects stand in canonical space."""

from __future__ import annotations

import numpy as np

from chona_model.data.dataset import Dataset
from chona_model.figure import OBJECT_CLEARANCE

UNKNOWN_RADIUS = 0.5
"""Of objects where there are none, so that a model of a person alone has the same canonical space, metres."""


def object_distance(dataset: Dataset) -> float:
    """How far in front of the root objects stand: clear of the body, metres."""
    reach = [np.maximum(np.abs(thing.lower), np.abs(thing.upper)) for thing in dataset.objects.values()]
    return OBJECT_CLEARANCE + max((float(np.linalg.norm(corner)) for corner in reach), default=UNKNOWN_RADIUS)
