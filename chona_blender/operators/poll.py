"""Whether a button is on, and what its tooltip says where it is off."""

from __future__ import annotations

import bpy

from ..readiness import NO_MODEL


def allowed(cls: type, why_not: str) -> bool:
    """What an operator's ``poll`` returns; where words speak against it, the button's tooltip shows them."""
    if why_not:
        cls.poll_message_set(why_not)  # type: ignore[attr-defined]
    return not why_not


def needs(cls: type, there: object, words: str) -> bool:
    """As ``allowed``: on where something is there, else the words say what is missing."""
    return allowed(cls, "" if there else words)


def needs_model(cls: type, context: bpy.types.Context) -> bool:
    """As ``allowed``: on where the selected actor has a model."""
    actor = context.scene.chona.actor
    return needs(cls, actor is not None and actor.model_path, NO_MODEL)
