"""The models that the actors of a shot are of: found, checked, hashed and loaded, each once."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from chona_model.actor import Actor
from chona_model.formats.model_file import ModelFileError, ModelHeader, file_hash, read_header
from chona_model.formats.shot import Shot, ShotActor, ShotError
from chona_model.model_store import load_with_report
from chona_model.plain_json import shortened
from chona_model.sight import shown_identities

SUFFIX = ".safetensors"
LONGEST_PATH = 1000
"""Characters of a path; systems take a few thousand bytes."""

FileState = tuple[int, int, int, int]


@dataclass(frozen=True)
class LoadedModels:
    """What a shot shows, in memory.

    Attributes:
        actors: what renders each of the shot's actors; those of one model share one.
        left: names of the identities that were not loaded; bytes_left: of tensors that were not read.
    """

    actors: tuple[Actor, ...]
    left: tuple[str, ...]
    bytes_left: int


@dataclass(frozen=True)
class ShotModels:
    """Which actor is of which model.

    Attributes:
        paths: of every actor's model, in the shot's order; headers: by path, each file once.
        states: of the files when they were found: device and number, time and size.
    """

    paths: tuple[Path, ...]
    headers: Mapping[Path, ModelHeader]
    states: Mapping[Path, FileState | None]

    @property
    def of_actors(self) -> list[ModelHeader]:
        """The header of every actor's model, in the shot's order."""
        return [self.headers[path] for path in self.paths]

    @property
    def identities(self) -> tuple[str, ...]:
        """Names of everybody and everything that the models hold."""
        return tuple(name for header in self.headers.values() for name in (*header.persons, *header.objects))

    @property
    def size_bytes(self) -> int:
        """Of all files."""
        return sum(header.size_bytes for header in self.headers.values())

    def digest(self) -> str:
        """What baked frames know their models by: the file's ``file_hash``; of several models, a hash of every actor's.

        Raises:
            ModelFileError: a file has been damaged meanwhile.
        """
        hashes = {path: file_hash(path) for path in self.headers}
        if len(set(hashes.values())) == 1:
            return next(iter(hashes.values()))
        return hashlib.sha256("\n".join(hashes[path] for path in self.paths).encode()).hexdigest()

    def replaced(self, digest: str) -> bool:
        """Whether a file is by now of another model than the one that had a ``digest``; one that is gone is not."""
        if all(_state(path) in {state, None} for path, state in self.states.items()):
            return False
        try:  # what was measured of a model may have been written into its file: it is the same model
            return self.digest() != digest
        except ModelFileError:
            return True

    def load(self, shot: Shot, device: str) -> LoadedModels:
        """Loads of every model the persons and objects that its own actors show.

        Raises:
            ModelFileError: a model cannot be loaded.
        """
        loaded: dict[Path, Actor] = {}
        left: list[str] = []
        spared = 0
        for path in self.headers:
            members = [member for member, own in zip(shot.actors, self.paths, strict=True) if own == path]
            loaded[path], report = load_with_report(path, device, *shown_identities(members))
            left += report.left
            spared += report.bytes_left
        return LoadedModels(tuple(loaded[path] for path in self.paths), tuple(left), spared)


def find_models(shot: Shot, first: Path, folder: Path | None) -> ShotModels:
    """The model of every actor, with its header, and everything that the actors want in it.

    Args:
        first: of the actors that name none.
        folder: of the shot's file, which relative paths start from; None for a shot that came through a pipe.

    Raises:
        ShotError: an actor's model is no file, or lacks its person, an object or a bone; the message names the actor.
        ModelFileError: a model's file is damaged or of another version.
    """
    named = [_path(member, first, folder) for member in shot.actors]
    same: dict[Path, Path] = {}
    paths = tuple(same.setdefault(path.resolve(), path) for path in named)
    states = {path: _state(path) for path in dict.fromkeys(paths)}
    found = ShotModels(paths, {path: read_header(path) for path in states}, states)
    check_actors(shot, found.of_actors)
    return found


def _state(path: Path) -> FileState | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size


def _path(member: ShotActor, first: Path, folder: Path | None) -> Path:
    if member.model is None:
        return first
    path = Path(member.model)
    who = f"actor '{member.name}' is of the model '{shortened(member.model)}'"
    if path.suffix != SUFFIX or "\0" in member.model or len(member.model) > LONGEST_PATH:
        raise ShotError(f"{who}, expected a {SUFFIX} file; choose one in the scene and write the shot again")
    if not path.is_absolute():
        if folder is None:
            raise ShotError(f"{who}, a relative path in a shot that has no folder; expected an absolute one")
        path = folder / path
    if not os.path.isfile(path):  # noqa: PTH113 - Path's own raises where a part is too long for a name
        raise ShotError(f"{who}, and there is no file {path}; copy the model there, or write the shot again")
    return path


def check_actors(shot: Shot, models: Sequence[Actor | ModelHeader]) -> None:
    """``ShotError`` where an actor wants a person, an object or a bone that its model lacks.

    Args:
        models: every actor's.
    """
    for member, model in zip(shot.actors, models, strict=True):
        if member.person is not None and member.person not in model.persons:
            raise ShotError(
                f"actor '{member.name}' wants the person '{member.person}', the model has "
                f"{', '.join(model.persons) or 'none'}"
            )
        for name in member.objects:
            if name not in model.objects:
                raise ShotError(f"actor '{member.name}' wants the object '{name}', the model has "
                                f"{', '.join(model.objects) or 'none'}")  # fmt: skip
        if member.person is not None and member.bones != model.skeleton.names:
            missing = [name for name in model.skeleton.names if name not in member.bones]
            raise ShotError(
                f"actor '{member.name}' lacks the model's bone '{missing[0]}': map it in the rig"
                if missing
                else f"actor '{member.name}' has its bones in another order than the model; write the shot again"
            )
