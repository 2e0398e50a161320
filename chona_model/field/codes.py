"""Identity codes of persons and objects, and compositional invariant learning (CIL)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

ABSENT = -1
"""Index of an identity that is not in the scene; its code is zero."""


class IdentityCodes(nn.Module):
    """The paper's v_h [N_h, C] and v_o [N_o, C], learned with the field.

    Args:
        n_persons, n_objects: identities, 0 or more.
        size: C, numbers a code.
    """

    def __init__(self, n_persons: int, n_objects: int, size: int) -> None:
        super().__init__()
        self.persons = nn.Parameter(torch.randn(n_persons, size) / size**0.5)
        self.objects = nn.Parameter(torch.randn(n_objects, size) / size**0.5)

    def person(self, index: Tensor) -> Tensor:
        """Codes [..., C] of persons [...]; zeros for ``ABSENT``."""
        return _look_up(self.persons, index, "person")

    def object(self, index: Tensor) -> Tensor:
        """Codes [..., C] of objects [...]; zeros for ``ABSENT``."""
        return _look_up(self.objects, index, "object")

    def forward(self, persons: Tensor, objects: Tensor) -> Tensor:
        """The field's condition: persons [U] and objects [U, N] to [U, C (1 + N)], the person's code first.

        Raises:
            IndexError: an index beyond the identities the model knows.
        """
        return torch.cat([self.person(persons), self.object(objects).flatten(-2)], dim=-1)


def _look_up(table: Tensor, index: Tensor, kind: str) -> Tensor:
    if index.numel() and not bool(((index >= ABSENT) & (index < len(table))).all()):
        raise IndexError(
            f"{kind} index {int(index.max())} or {int(index.min())} is outside -1…{len(table) - 1}: the model knows "
            f"{len(table)} {kind} identities"
        )
    # One row of zeros after the table: absent identities read it, and an empty table still has something to read.
    padded = torch.cat([table, torch.zeros_like(table[:1]) if len(table) else table.new_zeros(1, table.shape[1])])
    return padded[torch.where(index < 0, len(table), index)]


def step_generator(seed: int, step: int) -> torch.Generator:
    """A generator on the CPU that depends on seed and step alone, so that a resumed run repeats."""
    # 2^64 / golden ratio spreads neighbouring seeds, so that (seed, step + 1) and (seed + 1, step) differ.
    return torch.Generator().manual_seed((seed * 0x9E3779B97F4A7C15 + step) % 2**63)


def draw_invariant_codes(
    persons: Tensor,
    objects: Tensor,
    on_person: Tensor,
    on_object: Tensor,
    *,
    n_persons: int,
    n_objects: int,
    seed: int,
    step: int,
    background: bool = False,
) -> tuple[Tensor, Tensor]:
    """Compositional invariant learning: what a person looks like must not depend on the object's code, nor the reverse.

    On rays of the person every object index is replaced by a random one, on rays of an object the person's.  Rays of
    the background keep theirs, as in the paper, or are taken for either by lot: where identities have tables of their
    own and exchanged codes are only ever seen on the person, nothing tells them where it ends, and it grows fat.  In
    one field for all, the place of another object would be told to be empty.  Present identities are replaced by
    identities, so with a single one nothing changes.  Absent ones may stay absent: they are drawn from the identities
    and absence, equally likely, so that a person captured alone also learns to be seen with objects.

    Args:
        persons: [R] index or −1; objects: [R, N] index or −1.
        on_person, on_object: [R] bool, disjoint.
        n_persons, n_objects: identities to draw from.
        seed, step: what the draw depends on; nothing else does, neither masks nor device.
        background: whether rays of the background are exchanged, too.

    Returns:
        persons [R], objects [R, N] with the drawn indices; the inputs are not changed.

    Raises:
        ValueError: a ray lies on both masks.
    """
    both = on_person & on_object
    if bool(both.any()):
        raise ValueError(
            f"{int(both.sum())} rays lie on the person's and the object's mask at once; masks must be disjoint"
        )
    generator = step_generator(seed, step)
    # Uniform numbers are drawn for all rays whatever the masks say; floor(u · n) needs no division or modulus.
    uniform = torch.rand(len(persons), 1 + objects.shape[1], generator=generator, dtype=torch.float64)
    uniform = uniform.to(persons.device)
    if background:
        heads = torch.rand(len(persons), generator=generator, dtype=torch.float64).to(persons.device) < 0.5
        nothing = ~(on_person | on_object)
        on_person, on_object = on_person | (nothing & heads), on_object | (nothing & ~heads)
    drawn_persons = _draw(uniform[:, 0], persons, n_persons)
    drawn_objects = _draw(uniform[:, 1:], objects, n_objects)
    return (
        torch.where(on_object, drawn_persons, persons),
        torch.where(on_person[:, None], drawn_objects, objects),
    )


def _draw(uniform: Tensor, current: Tensor, count: int) -> Tensor:
    if count == 0:
        return current
    present = (uniform * count).long().clamp(max=count - 1)
    absent = (uniform * (count + 1)).long().clamp(max=count) + ABSENT
    return torch.where(current >= 0, present, absent)
