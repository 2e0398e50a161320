"""One of several processes that make files in one folder: ``claiming_process.py OUT LATE SECONDS PATIENCE COUNT``.

Its folder is seen as NFS clients see theirs: what was once looked up, found or missing, is believed for LATE seconds;
what the process makes itself it sees at once.  An item takes SECONDS.  Every one that is begun and every one that is
put into its place is a line of OUT/log.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from chona_model.claims import Claims, TakenOver, each_once
from chona_model.formats.atomic import atomic_path

OUT, LATE, SECONDS, PATIENCE, COUNT = Path(sys.argv[1]), *map(float, sys.argv[2:5]), int(sys.argv[5])

believed: dict[str, tuple[float, bytes | None]] = {}
truth, create = Path.read_bytes, os.open


def read_late(path: Path) -> bytes:
    """``Path.read_bytes`` of a client with a cache."""
    until, content = believed.get(str(path), (0.0, None))
    if time.monotonic() >= until:
        try:
            content = truth(path)
        except FileNotFoundError:
            content = None
        believed[str(path)] = (time.monotonic() + LATE, content)
    if content is None:
        raise FileNotFoundError(path)
    return content


def create_and_see(path: str | Path, flags: int, *rest: int, **more: int) -> int:
    """``os.open`` of a client with a cache: the server decides, and what one makes oneself is known."""
    handle = create(path, flags, *rest, **more)
    believed.pop(str(path), None)
    return handle


def log(word: str, item: int) -> None:
    """A line that no other's gets into."""
    handle = create(OUT / "log", os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    os.write(handle, f"{word} {item} {os.getpid()}\n".encode())
    os.close(handle)


def place(item: int) -> Path:
    return OUT / f"item_{item:04d}"


def is_there(item: int) -> bool:
    try:
        return place(item).read_bytes() == b"whole"
    except FileNotFoundError:
        return False


def make(item: int, confirm: Callable[[], None]) -> None:
    log("begun", item)
    time.sleep(SECONDS)
    try:
        with atomic_path(place(item), confirm) as temporary:
            temporary.write_bytes(b"whole")
    except TakenOver:
        log("dropped", item)
        raise
    believed.pop(str(place(item)), None)
    log("made", item)


Path.read_bytes, os.open = read_late, create_and_see  # type: ignore[method-assign, assignment]
with Claims(OUT, PATIENCE) as claims:
    for _ in each_once(
        range(COUNT), is_there, make, lambda: False, claims, lambda item: (f"item_{item:04d}", "the same")
    ):
        pass
