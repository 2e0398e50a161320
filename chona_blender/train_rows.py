"""The list of trainings: one row each, kept where undo does not reach, and saved with the file.

Rows belong to the window manager, which undo leaves alone; a training that has ended must not come back with Ctrl+Z.
They are written into the file's first scene when it is saved, and read from there when it is opened.
"""

import json
from pathlib import Path
from typing import Any

import bpy

from . import train_view

WAITING, RUNNING, PAUSED, DONE, FAILED, CANCELLED = "WAITING", "RUNNING", "PAUSED", "DONE", "FAILED", "CANCELLED"
STATES = (
    (WAITING, "Waiting", "Starts when what runs now has ended", "TIME", 0),
    (RUNNING, "Running", "In progress", "PLAY", 1),
    (PAUSED, "Paused", "Stopped with a checkpoint; Resume goes on from it", "PAUSE", 2),
    (DONE, "Done", "Its model is written", "CHECKMARK", 3),
    (FAILED, "Failed", "Ended with an error", "ERROR", 4),
    (CANCELLED, "Cancelled", "Stopped by the user; its checkpoint stays, and Resume goes on from it", "X", 5),
)
SETTINGS = (
    "data_folder", "data_format", "sequences", "run_folder", "base", "identities", "object_size", "method", "minutes",
    "steps", "preview", "resume", "detach",
)  # fmt: skip
SAVED = ("key", "name", "state", "share", "words", *SETTINGS)


class CHONA_PG_training(bpy.types.PropertyGroup):
    """One training: what was set when it was added, and how far it is.  Folders are absolute."""

    key: bpy.props.StringProperty(name="Key", description="Unlike every other training's")  # type: ignore[valid-type]
    name: bpy.props.StringProperty(name="Training", description="Name of its result folder")  # type: ignore[valid-type]
    state: bpy.props.EnumProperty(name="State", description="How it is", items=STATES)  # type: ignore[valid-type]
    share: bpy.props.FloatProperty(name="Done", description="Share that is done", min=0.0, max=1.0)  # type: ignore[valid-type]
    words: bpy.props.StringProperty(name="Words", description="What it has said last")  # type: ignore[valid-type]
    data_folder: bpy.props.StringProperty(name="Data", description="Folder with the captures")  # type: ignore[valid-type]
    data_format: bpy.props.StringProperty(name="Format", description="Layout of the data folder")  # type: ignore[valid-type]
    sequences: bpy.props.StringProperty(name="Sequences", description="With commas; empty for all")  # type: ignore[valid-type]
    run_folder: bpy.props.StringProperty(name="Result", description="Folder of the model")  # type: ignore[valid-type]
    base: bpy.props.StringProperty(name="Add To", description="Model that is added to; or empty")  # type: ignore[valid-type]
    identities: bpy.props.StringProperty(name="Who", description="What is added to it, with commas")  # type: ignore[valid-type]
    object_size: bpy.props.FloatProperty(name="Object Size", description="Of scans, metres")  # type: ignore[valid-type]
    method: bpy.props.StringProperty(name="Method", description="Which networks are trained")  # type: ignore[valid-type]
    minutes: bpy.props.FloatProperty(name="Time", description="How long, in minutes")  # type: ignore[valid-type]
    steps: bpy.props.IntProperty(name="Steps", description="How many; 0 goes by the time")  # type: ignore[valid-type]
    preview: bpy.props.FloatProperty(name="Picture", description="Seconds between two; 0 for none")  # type: ignore[valid-type]
    resume: bpy.props.BoolProperty(name="Resume", description="Goes on from its checkpoint")  # type: ignore[valid-type]
    detach: bpy.props.BoolProperty(name="Detach", description="Goes on when Blender ends")  # type: ignore[valid-type]


def _selected(_self: "CHONA_PG_trainings", _context: bpy.types.Context) -> None:
    row = selected()
    train_view.choose(None if row is None else Path(row.run_folder))


class CHONA_PG_trainings(bpy.types.PropertyGroup):
    """The list, and its selected row."""

    rows: bpy.props.CollectionProperty(  # type: ignore[valid-type]
        type=CHONA_PG_training, name="Trainings", description="Trainings one after the other, the first one first"
    )
    active: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Training", description="The selected row of the list of trainings", options={"HIDDEN"}, update=_selected
    )


def trainings() -> CHONA_PG_trainings:
    """The list of this Blender's file."""
    return bpy.context.window_manager.chona_trainings


def rows() -> list[CHONA_PG_training]:
    """All rows, the first one first.  Not to be kept: adding or removing a row moves them."""
    return list(trainings().rows)


def row_of(key: str) -> CHONA_PG_training | None:
    """The row of a training that may have been removed."""
    return next((row for row in trainings().rows if row.key == key), None)


def selected() -> CHONA_PG_training | None:
    """The selected row; None in an empty list."""
    shown = trainings()
    return shown.rows[min(shown.active, len(shown.rows) - 1)] if shown.rows else None


def select(key: str) -> None:
    """Make the row of a training the selected one, and show its picture."""
    list_ = trainings()
    list_.active = next(index for index, row in enumerate(list_.rows) if row.key == key)


def as_text() -> str:
    """The list as it is saved with a file."""
    return json.dumps([{name: getattr(row, name) for name in SAVED} for row in rows()])


def from_text(text: str) -> None:
    """Show a saved list.  What ran when the file was saved is paused: its process ended with its Blender, or else
    ``pick_up`` finds it."""
    shown = trainings()
    shown.rows.clear()
    for saved in _understood(text):
        row = shown.rows.add()
        for name, value in saved.items():
            setattr(row, name, value)
        if row.state == RUNNING:
            row.state, row.resume = PAUSED, True
    shown.active = 0


def _understood(text: str) -> list[dict[str, Any]]:
    """The rows that a text holds; those that another version wrote differently are left out."""
    try:
        entries = json.loads(text or "[]")
    except ValueError:
        return []
    kinds = CHONA_PG_training.bl_rna.properties
    known = {WAITING, RUNNING, PAUSED, DONE, FAILED, CANCELLED}

    def fits(name: str, value: object) -> bool:
        kind = kinds[name].type
        if kind in {"STRING", "ENUM"}:
            return isinstance(value, str) and (name != "state" or value in known)
        return isinstance(value, bool) if kind == "BOOLEAN" else isinstance(value, int | float)

    whole = [entry for entry in entries if isinstance(entry, dict) and set(entry) == set(SAVED)]
    return [entry for entry in whole if all(fits(name, value) for name, value in entry.items())]


@bpy.app.handlers.persistent
def _save(*_: object) -> None:
    for index, scene in enumerate(bpy.data.scenes):
        text = as_text() if index == 0 and trainings().rows else ""
        if scene.chona.trainings != text:
            scene.chona.trainings = text


@bpy.app.handlers.persistent
def _load(*_: object) -> None:
    from_text(next((scene.chona.trainings for scene in bpy.data.scenes if scene.chona.trainings), ""))


def register() -> None:
    """Give the window manager its list, and the list its place in files."""
    bpy.types.WindowManager.chona_trainings = bpy.props.PointerProperty(type=CHONA_PG_trainings)
    bpy.app.handlers.save_pre.append(_save)
    bpy.app.handlers.load_post.append(_load)


def unregister() -> None:
    """Take it away."""
    bpy.app.handlers.load_post.remove(_load)
    bpy.app.handlers.save_pre.remove(_save)
    del bpy.types.WindowManager.chona_trainings


CLASSES = (CHONA_PG_training, CHONA_PG_trainings)
