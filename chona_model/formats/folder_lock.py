"""Locks on folders: who writes into one says so there, and a second who would write the same is refused.

A lock is a small file in the folder that names the process.  The process keeps it locked by the system, which lets go
when the process ends, however it ends: so a file that somebody else can lock is nobody's any more.  Shared folders may
not have such locks, or only within a machine.  There the process is looked for by its number and start where it is one
of this machine's; of another machine's the file's age counts, which its process keeps young.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import sys
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

import msgspec

from chona_model.formats.atomic import WriteError, clear_leftovers
from chona_model.owner import Owner, this_process
from chona_model.plain_json import JsonError, decode

BEAT_SECONDS, STALE_SECONDS = 15.0, 120.0
"""A lock is touched this often; of another machine's, one that was not for so long is nobody's."""
DOOR_SECONDS = 10.0
"""Longest time that somebody else may take to make his lock."""
DOOR, PREFIX, SUFFIX = ".chona-door", ".chona-", ".lock"
LOCKED_BYTE = 1 << 30
"""Windows locks bytes: one far behind the content, which others shall read."""


class FolderBusyError(OSError):
    """Another process writes what was to be written."""


class FolderLostError(OSError):
    """The folder that is written to was removed, or taken over by another process."""


@dataclass(frozen=True)
class Holder:
    """Who writes what into a folder.

    Attributes:
        owner: the process; since: when it began to, local time to the second, for people.
        what: ``training``, or ``the shot NAME``: locks on different things do not meet.
        frames: which frames of a shot; None for all there is.
        shared: whether others that share may write the same, see ``claims``.
    """

    owner: Owner
    since: str
    what: str
    frames: frozenset[int] | None
    shared: bool = False

    def meets(self, other: Holder) -> bool:
        """Whether both would write the same files."""
        if self.what != other.what or (self.shared and other.shared):
            return False
        return self.frames is None or other.frames is None or bool(self.frames & other.frames)

    def text(self) -> str:
        """As it stands in the file."""
        frames = None if self.frames is None else sorted(self.frames)
        return json.dumps({**asdict(self.owner), "since": self.since, "what": self.what, "frames": frames,
                           "shared": self.shared})  # fmt: skip


_Words = Annotated[str, msgspec.Meta(max_length=400)]


@dataclass(frozen=True)
class _Written:
    """What a lock's file holds: anybody may have written it."""

    host: _Words
    machine: _Words
    pid: Annotated[int, msgspec.Meta(ge=1, lt=1 << 32)]
    started: _Words
    since: _Words
    what: _Words
    frames: frozenset[int] | None
    shared: bool


def parse_holder(text: str) -> Holder | None:
    """Inverse of ``Holder.text``; None where it is something else."""
    try:
        written = decode(text, _Written)
    except JsonError:
        return None
    owner = Owner(written.host, written.machine, written.pid, written.started)
    return Holder(owner, written.since, written.what, written.frames, written.shared)


class FolderLock:
    """A lock that is held."""

    def __init__(self, path: Path, holder: Holder) -> None:
        self.path, self.holder = path, holder
        self._ended = threading.Event()
        self._beats = threading.Thread(target=self._beat, daemon=True)
        self._beats.start()

    def check(self) -> None:
        """Look before anything is written whether it still belongs here.

        Raises:
            FolderLostError: the folder was removed, or another process has taken over.
        """
        if self.path.exists():
            return
        folder = self.path.parent
        if not folder.is_dir():
            raise FolderLostError(
                f"the folder {folder} was removed while {self.holder.what} was written into it; run the command "
                "again to begin anew, or bring the folder back first to go on with what was in it"
            )
        raise FolderLostError(
            f"{self.holder.what} in {folder} was taken over by another process while this one stood still, or its "
            f"file {self.path.name} was deleted; nothing more is written: run the command again to go on"
        )

    def release(self) -> None:
        """Nobody is in the way any more."""
        self._ended.set()
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)

    def _beat(self) -> None:
        while not self._ended.wait(BEAT_SECONDS):
            with contextlib.suppress(OSError):
                os.utime(self.path)


@contextmanager
def lock_folder(
    folder: Path, what: str, frames: Collection[int] | None = None, shared: bool = False
) -> Iterator[FolderLock]:
    """Locks what is written into ``folder`` while the block runs, and clears away what was killed has left there.

    Args:
        what: ``training``, or ``the shot NAME``; frames: of a shot, those that are written; shared: see
            ``Holder``.

    Raises:
        FolderBusyError: another process writes the same.  WriteError: the folder cannot be written to.
    """
    now = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S")
    holder = Holder(this_process(), now, what, None if frames is None else frozenset(frames), shared)
    path = folder / f"{PREFIX}{secrets.token_hex(8)}{SUFFIX}"
    with contextlib.ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with _door(folder):
                _refuse_second(folder, holder)
                handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
                held = FolderLock(path, holder)
                stack.callback(held.release)
                stack.callback(os.close, handle)
                try_lock(handle)
                os.write(handle, holder.text().encode())
                clear_leftovers(folder, os.fstat(handle).st_mtime)
        except (FolderBusyError, WriteError):
            raise
        except OSError as error:
            raise WriteError(folder, error) from error
        yield held


def _refuse_second(folder: Path, holder: Holder) -> None:
    """Raises FolderBusyError where somebody writes the same; removes locks that are nobody's."""
    for path, other, alive in _look(folder):
        if not alive:
            with contextlib.suppress(OSError):
                path.unlink()
        elif other is None or holder.meets(other):
            raise FolderBusyError(_words(path, other, holder))


def _words(path: Path, other: Holder | None, holder: Holder) -> str:
    begin = f"{holder.what} is being written into {path.parent} already"
    end = "wait until it has ended, stop it, or choose another folder"
    if other is None:
        return f"{begin}, by a process that {path.name} does not name; {end}"
    who = f"by process {other.owner.pid} on {other.owner.host} since {other.since}"
    if not other.owner.is_here:
        end += f"; if it does not run any more, this is known after {STALE_SECONDS / 60:.0f} minutes"
    frames = holder.frames & other.frames if holder.frames and other.frames else None
    shared = f" ({len(frames)} of the same frames, the first is {min(frames)})" if frames else ""
    return f"{begin}, {who}{shared}; {end}"


def _look(folder: Path) -> list[tuple[Path, Holder | None, bool]]:
    """Every lock's file, who made it, and whether that process may run still."""
    found, now = [], _folder_now(folder)
    for path in sorted(folder.glob(f"{PREFIX}*{SUFFIX}")):
        try:
            handle = os.open(path, os.O_RDWR)
        except OSError:  # it has ended this very moment
            continue
        try:
            holder = parse_holder(os.read(handle, 1 << 22).decode("utf-8", "replace"))
            free, age = try_lock(handle), now - os.fstat(handle).st_mtime
        finally:
            os.close(handle)
        found.append((path, holder, _may_run(holder, free, age)))
    return found


def _may_run(holder: Holder | None, free: bool | None, age: float) -> bool:
    """Whether a lock's process may run still.

    Args:
        free: whether nobody has the file locked, None where files cannot be locked; age: of the file, seconds.
    """
    if free is False:
        return True
    if holder is None:  # killed before it could say who it is
        return free is None and age < STALE_SECONDS
    if holder.owner.is_here:
        return free is None and holder.owner.is_alive()
    return age < STALE_SECONDS  # another machine's lock may not be seen here


def _folder_now(folder: Path) -> float:
    """The time by the clock that stamps the folder's files: a server's may differ from this machine's."""
    os.utime(folder / DOOR)
    return (folder / DOOR).stat().st_mtime


@contextmanager
def _door(folder: Path) -> Iterator[None]:
    """One at a time looks at the locks and makes his own."""
    path, until = folder / DOOR, time.monotonic() + DOOR_SECONDS
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            locked = try_lock(handle)
            # Whoever was here before may have removed the file that was just opened.
            if locked is None or (locked and _is_file(path, handle)):
                try:
                    yield
                finally:
                    with contextlib.suppress(OSError):
                        path.unlink()
                return
        finally:
            os.close(handle)
        if time.monotonic() > until:
            raise FolderBusyError(
                f"another process has been about to write into {folder} for {DOOR_SECONDS:.0f} seconds; end it, or "
                "choose another folder"
            )
        time.sleep(0.02)


def _is_file(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(handle))
    except OSError:
        return False


def try_lock(handle: int) -> bool | None:
    """Locks an open file as long as it is open: False where another has it, None where files cannot be locked."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(handle, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            os.lseek(handle, 0, os.SEEK_SET)
        return True
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True
