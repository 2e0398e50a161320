"""``chona doctor --bundle``: what somebody who looks for a mistake needs to know, in one file that tells no secrets.

It holds versions, the machine, logs, settings and headers of models and shots: no picture, no pose, and of paths and
of the user nothing but the names of files.
"""

from __future__ import annotations

import contextlib
import getpass
import importlib.metadata
import io
import json
import os
import platform
import re
import sys
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from chona_model.doctor import examine, to_text
from chona_model.formats.atomic import write_bytes
from chona_model.formats.model_file import ModelFileError, read_metadata
from chona_model.formats.shot import ShotError, read_shot
from chona_model.journal import NAME as JOURNAL
from chona_model.journal import journal_folder
from chona_model.owner import this_process

LOG_BYTES = 1 << 18
"""Of the end of every log."""
VARIABLES = ("CHONA_", "CUDA_", "NUMBA_", "OMP_", "MKL_", "PYTORCH_")
LEFT_OUT = ("poses_seen",)
"""Of a model's header: poses are the user's own."""
_QUOTED = re.compile(r"""(["'])((?:[A-Za-z]:)?(?:(?!\1)[^\n])*[/\\](?:(?!\1)[^\n])*)\1""")
_PATH = re.compile(r"(?<![\w/\\.<])(?:[A-Za-z]:|~)?(?:[/\\]+[^\s/\\'\",;()\[\]{}]+)+[/\\]?")


def write_bundle(path: Path, given: Iterable[Path]) -> list[str]:
    """Writes the file.

    Args:
        given: model files, shots, and folders of trainings and bakes, whose logs and headers go along.

    Returns:
        the names of what is in it.

    Raises:
        WriteError: it cannot be written.
    """
    content, names = io.BytesIO(), []
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        wanted = [path.absolute() for path in given]
        known = [*wanted, Path.cwd() / "file", Path.home() / "file", Path(sys.prefix) / "file", Path(__file__)]
        for name, text in _entries(wanted):
            archive.writestr(name, without_secrets(text, known))
            names.append(name)
    write_bytes(path, content.getvalue())
    return names


def without_secrets(text: str, known: Iterable[Path] = ()) -> str:
    """The text with paths cut to the names of their files, and without the user's and the machine's name.

    Where a path ends can be told where it stands in quotes, or has no spaces; others are cut where they begin with
    one of these, or with a folder of one of the ``known``.
    """
    paths = {*map(str, known), *(match[2] for match in _QUOTED.finditer(text))}
    folders = {str(folder) for path in paths for folder in Path(path).parents if len(folder.parts) > 1}
    for folder in sorted(folders, key=len, reverse=True):
        text = text.replace(f"{folder}/", "").replace(f"{folder}\\", "")
    text = _QUOTED.sub(lambda match: f"{match[1]}{_name(match[2])}{match[1]}", text)
    text = _PATH.sub(lambda match: _name(match[0]), text)
    for name, stand_in in ((_user(), "USER"), (platform.node(), "HOST")):
        if name and name != "root":
            text = re.sub(rf"\b{re.escape(name)}\b", stand_in, text)
    return text


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return ""


def _name(path: str) -> str:
    parts = [part for part in re.split(r"[/\\]+", path) if part]
    return parts[-1] if parts else path


def _entries(given: list[Path]) -> Iterator[tuple[str, str]]:
    """Names and texts of what goes into the file."""
    yield "doctor.txt", to_text(examine())
    yield "machine.json", _json(_machine())
    distributions = importlib.metadata.distributions()
    yield "packages.txt", "\n".join(sorted({f"{each.metadata['Name']} {each.version}" for each in distributions}))
    for log in sorted(journal_folder().glob(f"{JOURNAL}*")) if journal_folder().is_dir() else []:
        yield f"logs/{log.name}", _end_of(log)
    for number, path in enumerate(given, start=1):
        place = f"{number:02d}-{path.resolve().name}"
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        if path.is_dir():
            yield f"{place}/files.txt", "\n".join(f"{each.stat().st_size} {each.name}" for each in files)
        for file in files:
            for ending, text in _of_file(file):
                yield f"{place}/{file.name}{ending}", text


def _of_file(path: Path) -> Iterator[tuple[str, str]]:
    """What may be told of one file; nothing of a picture."""
    if path.suffix == ".safetensors":
        try:
            metadata: dict[str, Any] = {key: json.loads(text) for key, text in read_metadata(path).items()}
        except (ModelFileError, ValueError, OSError) as error:
            yield ".error.txt", str(error)
            return
        for part in (metadata, *metadata.values()):
            training = part.get("training", part) if isinstance(part, dict) else {}
            for name in LEFT_OUT if isinstance(training, dict) else ():
                training.pop(name, None)
        yield ".header.json", _json(metadata)
    elif path.name.endswith(".shot.npz"):
        try:
            shot = read_shot(path)
        except (ShotError, OSError) as error:
            yield ".error.txt", str(error)
            return
        actors = [[actor.name, actor.person, list(actor.objects), list(actor.bones)] for actor in shot.actors]
        facts = {"name": shot.name, "frames": len(shot), "size": [shot.width, shot.height], "camera": shot.camera_kind}
        yield ".header.json", _json({**facts, "fps": shot.fps, "actors": actors})
    elif path.suffix in (".jsonl", ".log"):
        yield ".txt", _end_of(path)


def _machine() -> dict[str, Any]:
    variables = {key: value for key, value in os.environ.items() if key.startswith(VARIABLES)}
    return {
        "system": platform.platform(), "processor": platform.processor() or platform.machine(),
        "threads": os.cpu_count(), "python": platform.python_version(), "started": this_process().started,
        "variables": variables,
    }  # fmt: skip


def _end_of(path: Path) -> str:
    with contextlib.suppress(OSError), path.open("rb") as file:
        file.seek(max(path.stat().st_size - LOG_BYTES, 0))
        return file.read().decode("utf-8", "replace")
    return ""


def _json(content: Any) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False)
