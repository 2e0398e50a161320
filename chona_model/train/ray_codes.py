"""Which identity codes each part of a grid model is told along every ray of a batch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from chona_model.field.codes import draw_invariant_codes
from chona_model.grid_model import GridModel, PosedFigure


def ray_codes(
    model: GridModel, posed: Sequence[PosedFigure], pose: np.ndarray, *, exchange: bool, seed: int, step: int
) -> tuple[Tensor, np.ndarray]:
    """Pairs of codes for a batch, with compositional invariant learning (CIL) or without.

    The paper gives a ray one pair: on the person its own code and any object's, on the object the reverse.  Here every
    part has a pair of its own, its own code with any of the other kind, on all rays.  So each is told where it ends as
    well as where it is, and nobody is told that another's place is empty: on rays of the background that keep their
    codes a person never meets an exchanged one, and grows fat under it; on rays where both parts are told an exchanged
    one, a large object learns under it where a smaller one ends.

    Args:
        posed: every training pose; pose: [R] each ray's.
        exchange: whether codes are exchanged.
        seed, step: what the draw depends on.

    Returns:
        pairs [Q, 2] of a person and an object, −1 for nobody, and int64 [R, 1 + N], which of them the person and every
        object slot is told along each ray.
    """
    slots = model.shape.object_slots
    shown = torch.full((len(posed), slots), -1)
    for row, figure in enumerate(posed):
        shown[row, : len(figure.objects)] = torch.tensor(figure.objects, dtype=torch.int64)
    persons = torch.tensor([figure.person for figure in posed])[torch.from_numpy(pose).long()]
    objects = shown[torch.from_numpy(pose).long()]
    n_persons, n_objects = len(model.persons), len(model.objects)
    told_persons, told_objects = persons, objects
    if exchange and (n_persons > 1 or n_objects > 1):
        every = torch.ones(len(persons), dtype=torch.bool)
        counts = {"n_persons": n_persons, "n_objects": n_objects, "seed": seed, "step": step}
        _, told_objects = draw_invariant_codes(persons, objects, on_person=every, on_object=~every, **counts)
        told_persons, _ = draw_invariant_codes(persons, objects, on_person=~every, on_object=every, **counts)
    if model.shape.field.own_codes:
        told_objects, told_persons = torch.full_like(objects, -1), torch.full_like(persons, -1)
    of_person = torch.cat([persons[:, None], told_persons[:, None].expand(-1, slots)], dim=1)
    of_object = torch.cat([told_objects[:, :1], objects], dim=1)
    pairs = torch.cartesian_prod(torch.arange(-1, n_persons), torch.arange(-1, n_objects))
    used, ray_pair = torch.unique((of_person + 1) * (n_objects + 1) + of_object + 1, return_inverse=True)
    return pairs[used], ray_pair.numpy()
