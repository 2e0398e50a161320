"""Files that are either whole or absent: written under a temporary name in the same folder, synced, renamed."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from chona_model.owner import Owner, this_process

OLD_SECONDS = 86400.0
"""After so long what another machine has left under a temporary name is given up."""

_TEMPORARY = re.compile(r"\..*\.(?P<machine>[0-9a-f]{8})-(?P<pid>\d+)-(?P<started>[^.]*)-[0-9a-f]{8}\.tmp(\.[^.]*)?")
_REMEDIES = {
    errno.ENOSPC: "free some space there, or choose another folder",
    errno.EDQUOT: "your share of that disk is used up: delete something, or choose another folder",
    errno.EFBIG: "this system lets no file grow so large: raise the limit (ulimit -f), or choose another folder",
    errno.EROFS: "the disk can be read only: make it writable, or choose another folder",
    errno.EACCES: "make the folder writable, or choose another",
    errno.EPERM: "make the folder writable, or choose another",
    errno.ENOENT: "the folder has been removed meanwhile: make it again, or choose another",
    errno.EIO: "look whether the disk is full or damaged, or choose another folder",
    errno.ESTALE: "the network drive is gone: connect it again",
}


class WriteError(OSError):
    """A file that could not be written: which, why, and what to do. What was there before is still there."""

    def __init__(self, path: Path, cause: OSError) -> None:
        reason = cause.strerror or str(cause) or type(cause).__name__
        remedy = _REMEDIES.get(cause.errno or 0, "look at that folder, or choose another")
        super().__init__(f"cannot write {path}: {reason}; {remedy}")
        self.errno = cause.errno


@contextmanager
def atomic_path(path: Path, confirm: Callable[[], None] | None = None) -> Iterator[Path]:
    """A temporary path to write to, which becomes ``path`` when the block ends without an exception.

    The temporary name starts with a dot and keeps the suffix (writers choose formats by it); it says which process
    writes it, see ``clear_leftovers``.  An interrupted block leaves whatever was at ``path`` before, as does
    ``confirm``, called last of all, where it raises.  Folders are made
    as needed.

    Raises:
        WriteError: the folder cannot be made or written to, or the disk is full.
    """
    owner = this_process()
    mark = f"{owner.machine}-{owner.pid}-{owner.started}-{secrets.token_hex(4)}"
    temporary = path.with_name(f".{path.stem}.{mark}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("r+b") as file:
            os.fsync(file.fileno())
        if confirm is not None:
            confirm()
        temporary.replace(path)
        _sync_folder(path.parent)
    except WriteError:
        raise
    except OSError as error:
        raise WriteError(path, error) from error
    finally:
        with contextlib.suppress(OSError):  # what could not be written may not be removed either
            temporary.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Writes ``content`` to ``path`` whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def clear_leftovers(folder: Path, now: float) -> int:
    """Removes what processes that were killed have left under temporary names; returns how many.

    A process of this machine is looked for; a file of another machine's goes when it is older than a day.

    Args:
        now: by the clock that stamps the folder's files, as ``st_mtime``.
    """
    removed = 0
    for path in folder.glob(".*.tmp*"):
        match = _TEMPORARY.fullmatch(path.name)
        if match is None:
            continue
        owner = Owner("", match["machine"], int(match["pid"]), match["started"])
        with contextlib.suppress(OSError):
            if owner.is_alive() or (not owner.is_here and now - path.stat().st_mtime < OLD_SECONDS):
                continue
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
            removed += 1
    return removed


def _sync_folder(folder: Path) -> None:
    """Makes a rename survive a power cut where the system can; Windows cannot open folders."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
