"""The rig families that are recognised by name: one family or maker a module, in the order in which ties are broken."""

from __future__ import annotations

from . import generic, mixamo, mpfb, rigify, smpl, unreal, vrm
from .family import Family, Found

FAMILIES: tuple[Family, ...] = (
    *smpl.FAMILIES,
    *rigify.FAMILIES,
    *mixamo.FAMILIES,
    *unreal.FAMILIES,
    *mpfb.FAMILIES,
    *vrm.FAMILIES,
    *generic.FAMILIES,
)

__all__ = ["FAMILIES", "Family", "Found"]
