"""The presets one can bake with: those that come with the program, and the user's own, by the names of their files.

Only the worker reads a preset's file; here the folder is listed, and only by `refresh`, never while drawing.
"""

from __future__ import annotations

import os
import re
import zlib
from pathlib import Path

import bpy

from .errors import ChonaError

PRESETS = (
    ("draft", "Draft", "Fastest: for timing and placement"),
    ("preview", "Preview", "Fast: good enough to judge a pose"),
    ("final", "Final", "For the final picture"),
    ("exact", "Exact", "Every step as in the paper, no shortcut: slow, for comparison"),
)
OWN = tuple(item[0] for item in PRESETS)
DEFAULT = 1
"""Number of the item `preview`."""

SUFFIX = ".json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,62}")

Item = tuple[str, str, str, str, int]

_users: list[str] = []
_items: dict[tuple[str, ...], list[Item]] = {}
"""Items of the drop-down by the names in it. Blender keeps no reference to the strings that a callback gives it:
whoever drops them sees rubbish in an open menu, so lists are made once and kept."""


def folder() -> Path:
    """Where the user's presets lie, as for the worker: `$CHONA_PRESETS`, else `.chona/presets` in the home folder."""
    given = os.environ.get("CHONA_PRESETS")
    return Path(given) if given else Path.home() / ".chona" / "presets"


def refresh() -> None:
    """Look into the user's folder again."""
    where = folder()
    try:
        found = sorted(path.stem for path in where.glob(f"*{SUFFIX}"))
    except OSError:  # a folder that may not be read has no presets; a bake with one says so
        found = []
    _users[:] = [name for name in found if _NAME.fullmatch(name) and name not in OWN]


def names() -> list[str]:
    """Every preset there is, the program's first."""
    return [*OWN, *_users]


def check(name: str) -> str:
    """The name itself, after another look into the folder.

    Raises:
        ChonaError: there is no such preset on this computer.
    """
    refresh()
    if name not in names():
        which = f"the preset {name!r} is not on this computer" if name else "no preset is chosen"
        raise ChonaError(
            f"{which}; there are {', '.join(names())}: choose one under Bake, or put the file "
            f"{name or 'NAME'}{SUFFIX} into {folder()}"
        )
    return name


def items(settings: bpy.types.PropertyGroup | None, _context: bpy.types.Context | None) -> list[Item]:
    """The drop-down's items. The one that a file was saved with stays among them when it is gone, and is called so."""
    chosen = settings.preset_name if settings is not None else ""
    missing = chosen if chosen and chosen not in names() else ""
    key = (*_users, missing)
    if key not in _items:
        made = [(*item, "NONE", index) for index, item in enumerate(PRESETS)]
        made += [(name, name, f"Your own, from {name}{SUFFIX}", "USER", _number(name)) for name in _users]
        if missing:
            words = f"It was chosen when this file was saved, and {missing}{SUFFIX} is not on this computer"
            made.append((missing, f"{missing} (missing)", words, "ERROR", _number(missing)))
        _items[key] = made
    return _items[key]


def _number(name: str) -> int:
    """Files keep an item's number: a name has the same on every computer, whatever other presets are there."""
    return 16 + zlib.crc32(name.encode()) % 2**30


@bpy.app.handlers.persistent
def _file_loaded(*_: object) -> None:
    refresh()


def register() -> None:
    """Look for the user's presets now and with every file."""
    refresh()
    bpy.app.handlers.load_post.append(_file_loaded)


def unregister() -> None:
    """Stop listening and forget."""
    bpy.app.handlers.load_post.remove(_file_loaded)
    _users.clear()
    _items.clear()
