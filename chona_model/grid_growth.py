"""A grid model with more identities than it was trained with: what it had renders as it did, to the bit.

Only what is a new identity's own is to be learned: its table, its occupancy, a person's skinning.  The perceptrons, the
light and everything of the others stay.  A new identity's code is the mean of its kind's: the others have only ever
been seen together with codes like those, and what it looks like fits into its table.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from chona_model.data.dataset import ObjectShape, Person
from chona_model.figure import pose_code_size
from chona_model.grid_model import GridModel, part_boxes
from chona_model.kernels.grid import grow_layout, lay_out_anew


@torch.no_grad()
def grown(model: GridModel, persons: Sequence[Person], objects: Sequence[ObjectShape]) -> GridModel:
    """The model with ``persons`` and ``objects`` after those it has; it is not changed itself.

    Args:
        model: no joint field, and nobody of the new names in it.
    """
    people, boxes = len(model.persons), part_boxes(model.skeleton, persons, objects, model.shape.reach)
    lower, upper = (
        np.concatenate([old[:people], new[: len(persons)], old[people:], new[len(persons) :]])
        for old, new in zip(model.boxes, boxes, strict=True)
    )
    result = GridModel(
        model.skeleton, {each.name: each for each in (*model.persons, *persons)},
        {each.name: each for each in (*model.objects, *objects)}, model.object_distance, model.shape,
        [*(model.grid(index) for index in range(people)), *(None for _ in persons)], (lower, upper),
    )  # fmt: skip
    places = [*range(people), *(len(persons) + part for part in range(people, len(model.boxes[0])))]
    _take_field(result, model, places)
    for part, place in enumerate(places):
        own = slice(model.occupancy.first[part], model.occupancy.first[part + 1])
        result.occupancy.part(place)[:] = model.occupancy.part(part)
        result.occupancy.support[result.occupancy.first[place] : result.occupancy.first[place + 1]] = (
            model.occupancy.support[own]
        )
    for index in range(people):
        result.volumes[index].load_state_dict(model.volumes[index].state_dict())
    _clear_untrained(result, model)
    return result


def _take_field(result: GridModel, model: GridModel, places: Sequence[int]) -> None:
    """The field's shared weights, the known identities' tables, and everyone's codes."""
    field, known = result.field, model.field
    own = {"table", "lower", "person_codes", "object_codes"}
    field.load_state_dict({name: value for name, value in known.state_dict().items() if name not in own}, strict=False)
    field.layout = grow_layout(known.layout, (result.boxes[1] - result.boxes[0]).max(axis=0))
    field.table[list(places)] = lay_out_anew(known.table, known.layout, field.layout)
    field.person_codes = _codes(known.person_codes, len(model.persons), len(result.persons))
    field.object_codes = _codes(known.object_codes, len(model.objects), len(result.objects))


def _clear_untrained(result: GridModel, model: GridModel) -> None:
    """Weights of the pose code's numbers that were zero in all of the training are as they were drawn: nothing that was
    learned is in them, and zeros keep the others as they look."""
    bones = pose_code_size(len(model.skeleton), 0)
    never = slice(bones, None) if not model.objects else slice(0, bones if not model.persons else 0)
    result.field.pose_in.weight[:, never] = 0.0
    for index in range(len(model.persons)):
        if result.shape.offset_rank:
            into = result.volume(index).offset_mix[0]
            assert isinstance(into, nn.Linear)
            into.weight[:, never] = 0.0


def _codes(known: Tensor, before: int, count: int) -> nn.Parameter:
    """Codes [count, C]: the ``before`` known ones, and the mean of these for each more; zeros where there were none."""
    mean = known[:before].mean(dim=0) if before else torch.zeros_like(known[0])
    return nn.Parameter(torch.cat([known[:before], mean.repeat(max(count, 1) - before, 1)]))
