"""Scenes that are found again after they were renamed, undone or deleted."""

from __future__ import annotations

import bpy


def scene_of(session_uid: int) -> bpy.types.Scene | None:
    """The scene with this ``session_uid``; None once it is deleted. Names change, and undo leaves dead pointers."""
    return next((each for each in bpy.data.scenes if each.session_uid == session_uid), None)
