"""The grid model that a training begins with: its tables by the method, or another model with room for more."""

from __future__ import annotations

from dataclasses import replace

from chona_model.data.dataset import Dataset
from chona_model.field.grid import GridShape
from chona_model.grid_growth import grown
from chona_model.grid_model import GridModel, GridModelShape
from chona_model.methods import Method
from chona_model.train.objects import object_distance

JOINT_ROWS = 19
"""log2 of the rows of a level where all persons or all objects share them: four identities' worth."""


def first_model(dataset: Dataset, method: Method, shape: GridModelShape | None, base: GridModel | None) -> GridModel:
    """A model of the dataset's identities, before the first step.

    Args:
        dataset: as the method sees it.
        shape: sizes, the usual ones when None.
        base: a model to which the identities are added in place of that, with its own sizes.
    """
    if base is not None:
        return grown(base, list(dataset.persons.values()), list(dataset.objects.values()))
    slots = max((len(view.pose.objects) for view in dataset.views), default=0)
    shape = shape or GridModelShape(field=GridShape(), object_slots=max(slots, 1))
    field = replace(shape.field, own_codes=method.own_codes)
    if method.joint:
        field = replace(field, joint=True, rows=max(field.rows, JOINT_ROWS))
    shape = replace(shape, field=field, turns_objects=method.objects != "placed", reach=method.reach)
    return GridModel(dataset.skeleton, dataset.persons, dataset.objects, object_distance(dataset), shape)
