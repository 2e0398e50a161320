"""The sizes of an exact model: everything needed to build one before its parameters are loaded."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

from chona_model.deform.skinning import DeformShape
from chona_model.field.radiance import FieldShape
from chona_model.plain_json import convert

Corner = tuple[float, float, float]

MOST = 1 << 16
"""Of bones, identities or numbers of a code."""

FARTHEST = 1e4
"""Metres; no figure and no canonical space is larger."""


@dataclass(frozen=True)
class ExactShape:
    """Everything needed to build an ``ExactModel`` before its parameters are loaded; plain numbers and tuples.

    Attributes:
        bones: B body bones; object_slots: N pseudo bones.
        n_persons, n_objects: identities; code_size: C of each code.
        lower, upper: corners of canonical space, metres; nothing outside has density.
        object_distance: metres from the root joint to the canonical object (+z), as ``Rig``'s.
        object_lower, object_upper: corners of each object identity's box in its own frame; empty for points.
        turns_objects: whether pseudo bones turn, or only move (see ``methods.py``); reach: metres beyond a body's own
            reach in which a person may hold what has no bone.
        deform, radiance: sizes of the perceptrons.
    """

    bones: int
    object_slots: int
    n_persons: int
    n_objects: int
    lower: Corner
    upper: Corner
    object_distance: float = 1.0
    code_size: int = 64
    object_lower: tuple[Corner, ...] = ()
    object_upper: tuple[Corner, ...] = ()
    turns_objects: bool = True
    reach: float = 0.0
    deform: DeformShape = field(default_factory=DeformShape)
    radiance: FieldShape = field(default_factory=FieldShape)

    def __post_init__(self) -> None:
        counts = (self.bones - 1, self.object_slots, self.n_persons, self.n_objects, self.code_size - 1)
        corners = (self.lower, self.upper, *self.object_lower, *self.object_upper)
        sound = all(0 <= count < MOST for count in counts)
        sound = sound and all(abs(value) <= FARTHEST for corner in corners for value in corner)
        if not (sound and 0.0 <= self.object_distance <= FARTHEST and 0.0 <= self.reach <= FARTHEST):
            raise ValueError(f"sizes of an exact model out of range: {str(self)[:200]}")
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"canonical space needs lower < upper, got {self.lower} and {self.upper}")
        if len(self.object_lower) != len(self.object_upper) or len(self.object_lower) not in {0, self.n_objects}:
            raise ValueError(
                f"expected a box for each of the {self.n_objects} objects or none, got {len(self.object_lower)} lower "
                f"and {len(self.object_upper)} upper corners"
            )

    @property
    def size(self) -> float:
        """The figure's size, the diagonal of canonical space in metres: tolerances are shares of it."""
        return sum((high - low) ** 2 for low, high in zip(self.lower, self.upper, strict=True)) ** 0.5

    @property
    def centre(self) -> tuple[float, ...]:
        """Middle of canonical space."""
        return tuple(0.5 * (low + high) for low, high in zip(self.lower, self.upper, strict=True))

    @property
    def scale(self) -> float:
        """Half the longest side of canonical space, which becomes 1 before encoding."""
        return 0.5 * max(high - low for low, high in zip(self.lower, self.upper, strict=True))

    def as_dict(self) -> dict[str, object]:
        """For a model file's metadata; ``from_dict`` reads it, also after a round trip through JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict) -> ExactShape:
        """Inverse of ``as_dict``; ``ValueError`` or ``TypeError`` where the values describe none."""
        corners = {name: tuple(tuple(corner) for corner in values[name]) for name in ("object_lower", "object_upper")}
        box = {name: tuple(values[name]) for name in ("lower", "upper")}
        nested = {"deform": DeformShape(**values["deform"]), "radiance": FieldShape(**values["radiance"])}
        return convert(asdict(cls(**{**values, **corners, **box, **nested})), cls)
