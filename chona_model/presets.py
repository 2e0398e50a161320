"""Presets by name: those that come with the program, and a user's own, one JSON file each."""

from __future__ import annotations

import contextlib
import json
import os
import re
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from chona_model.formats.atomic import write_bytes
from chona_model.plain_json import JsonError, convert, decode, read_text
from chona_model.settings import PRESETS, RENDER_PRESETS, RenderSettings, SettingsError

FORMAT, VERSION = "chona-preset", 1
SUFFIX = ".json"
MAX_BYTES = 65536
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,62}")


def presets_folder() -> Path:
    """Where a user's presets lie: ``$CHONA_PRESETS``, else ``.chona/presets`` in the home folder."""
    given = os.environ.get("CHONA_PRESETS")
    return Path(given) if given else Path.home() / ".chona" / "presets"


def user_presets() -> list[str]:
    """Names of a user's presets, sorted."""
    folder = presets_folder()
    return sorted(path.stem for path in folder.glob(f"*{SUFFIX}")) if folder.is_dir() else []


def every_preset() -> dict[str, RenderSettings]:
    """Settings by name: the program's, then the user's. A file that is no preset is not in the way of the others."""
    found = dict(RENDER_PRESETS)
    for name in user_presets():
        with contextlib.suppress(SettingsError):
            found[name] = find_preset(name)
    return found


def find_preset(name: str) -> RenderSettings:
    """Settings by a preset's name, or by the path of a preset's file.

    Raises:
        SettingsError: there is none, or its file breaks the format.
    """
    if name in RENDER_PRESETS:
        return RENDER_PRESETS[name]
    is_path = name.endswith(SUFFIX) or any(mark in name for mark in ("/", "\\"))
    path = Path(name) if is_path else presets_folder() / f"{name}{SUFFIX}"
    if path.is_file():
        return read_preset(path)
    known = ", ".join([*PRESETS, *user_presets()])
    raise SettingsError(
        f"there is no preset '{name}'; expected one of {known}, or the path of a preset's {SUFFIX} file: "
        "'chona trade --save-preset NAME' makes one"
    )


def save_preset(name: str, settings: RenderSettings, path: Path | None = None) -> Path:
    """Writes a preset under a name of the user's, in their folder or to ``path``.

    Raises:
        SettingsError: a name that is taken by the program or cannot be a file's.
    """
    check_name(name)
    path = path or presets_folder() / f"{name}{SUFFIX}"
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"format": FORMAT, "version": VERSION, "settings": asdict(replace(settings, preset=name))}
    write_bytes(path, (json.dumps(content, indent=1) + "\n").encode())
    return path


def check_name(name: str) -> None:
    """``SettingsError`` where a preset cannot be called so."""
    if name in PRESETS:
        raise SettingsError(f"the preset '{name}' comes with the program and stays as it is; choose another name")
    if not _NAME.fullmatch(name) or name.endswith((".", " ")):
        raise SettingsError(f"a preset cannot be called '{name}'; expected letters, digits, spaces, '.', '_' and '-'")


def read_preset(path: Path) -> RenderSettings:
    """Reads and checks a preset's file.

    Raises:
        SettingsError: it is none; the message names the file and the field.
    """
    try:
        content = decode(read_text(path, MAX_BYTES), Any)
        if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("version") != VERSION:
            raise SettingsError(f"{path} is no preset of version {VERSION}; 'chona trade --save-preset' makes one")
        _check_fields(content.get("settings"), RenderSettings, "", path)
        return convert(content["settings"], RenderSettings)
    except (OSError, JsonError) as error:
        raise SettingsError(f"cannot use the preset {path}: {error}; save it again") from error


def _check_fields(content: Any, kind: Any, where: str, path: Path) -> None:
    """Every field once and none besides: what is missing would silently be a default."""
    if not isinstance(content, dict):
        raise SettingsError(f"{path} has no settings at '{where or 'settings'}'; save the preset again")
    known = {field.name: field for field in fields(kind)}
    unknown, missing = sorted(set(content) - set(known)), sorted(set(known) - set(content))
    if unknown or missing:
        words = f"an unknown field '{where}{unknown[0]}'" if unknown else f"no field '{where}{missing[0]}'"
        raise SettingsError(f"{path} has {words}: it was written for another version; save the preset again")
    for name, field in known.items():
        if is_dataclass(field.default):
            _check_fields(content[name], type(field.default), f"{where}{name}.", path)
