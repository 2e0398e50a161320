"""Which identity codes each part of a grid model is told along every ray of a batch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from chona_model.field.codes import draw_invariant_codes
from chona_model.grid_model import GridModel, PosedFigure


def ray_codes(
    model: GridModel, posed: Sequence[PosedFigure], pose: np.ndarray, part: np.ndarray, *, exchange: bool, seed: int,
    step: int,
) -> tuple[Tensor, np.ndarray]:  # fmt: skip
    """Pairs of codes for a batch, with compositional invariant learning (CIL) or without.

    Args:
        posed: every training pose; pose: [R] each ray's.
        part: [R] what each ray shows: 0 (neither), 1 (person) or 2 (object).
        exchange: whether codes of what a ray does not show are exchanged, see ``draw_invariant_codes``.
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
    if exchange and (n_persons > 1 or n_objects > 1):
        persons, objects = draw_invariant_codes(
            persons, objects, torch.from_numpy(part == 1), torch.from_numpy(part == 2),
            n_persons=n_persons, n_objects=n_objects, seed=seed, step=step, background=True,
        )  # fmt: skip
    if model.shape.field.own_codes:
        nobody = torch.full((len(persons), 1), -1)
        of_person = torch.cat([persons[:, None], nobody.expand(-1, slots)], dim=1)
        of_object = torch.cat([nobody, objects], dim=1)
    else:
        of_person, of_object = persons[:, None], torch.cat([objects[:, :1], objects], dim=1)
    pairs = torch.cartesian_prod(torch.arange(-1, n_persons), torch.arange(-1, n_objects))
    used, ray_pair = torch.unique((of_person + 1) * (n_objects + 1) + of_object + 1, return_inverse=True)
    return pairs[used], ray_pair.numpy()
