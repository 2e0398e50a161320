"""Claims on frames: processes on several computers bake into one folder, and no frame is rendered twice.

A claim is a small file, ``OUT/.chona-claims/walk_0001.0.json``, made with O_CREAT | O_EXCL: NFS (from version 3) and
SMB decide at the server who of many makes it, whatever their caches show.  Whoever made it holds the frame and writes
a growing number into it; a claim whose number has not grown for ``patience`` seconds, by the observer's own clock, is
taken over by making the claim of the next generation, ``walk_0001.1.json``, which again one alone can.  So no clock is
compared with another's, nothing is taken away from under anybody, and a process that wakes up late sees a later
generation and drops its frame.  Renaming could not do this: it replaces what is there.

The claim of a finished frame stays a while.  Whoever does not see the frame yet, since folders of other computers are
seen late, finds the claim and waits; it is taken for abandoned only when the frame has not shown up for ``patience``.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

FOLDER = ".chona-claims"
"""Beside the frames; may be deleted when no bake runs."""
BEATS = 6
"""Signs of life within ``patience``: reading them late by up to 4/6 of it does no harm."""
KEPT = 2
"""After so many times ``patience`` everybody has seen the frame, and its claim is removed."""
LOOK_SECONDS, STOP_SECONDS = 2.0, 0.05
"""Between two looks at what others hold, at most; between two at whether to stop."""
RECORD_BYTES = 1024
"""Of a claim, padded: a sign of life replaces it in place."""
MOST_BYTES = 1 << 16
"""Of a claim that is read: anybody may have made it."""
_HELD, _DONE, _FREE = "held", "done", "free"


class TakenOver(Exception):
    """Another process makes it by now: this one gave no sign of life for long."""


def each_once(
    items: Iterable[int],
    is_there: Callable[[int], bool],
    make: Callable[[int, Callable[[], None]], None],
    stopped: Callable[[], bool],
    claims: Claims | None = None,
    name_and_key: Callable[[int], tuple[str, str]] | None = None,
    waits: Callable[[int], None] = lambda _: None,
) -> Iterator[tuple[int, bool]]:
    """Makes what is not there, each item by one process; yields every item when it is there, and whether it was made.

    What others hold comes last: it is there in the end, or was abandoned and is made here.

    Args:
        is_there: whether an item needs not be made.
        make: makes an item; calls its second argument right before it puts the item into its place, which raises
            ``TakenOver`` where another process makes it by now.
        stopped: asked before every item and while waiting.
        claims: None where nobody else makes any.
        name_and_key: of an item's claim, see ``Claims.take``.
        waits: told how many are left, which others hold.
    """
    waiting = list(items)
    while waiting and not stopped():
        later = []
        for item in waiting:
            if stopped():
                return
            if is_there(item):
                yield item, False
            elif claims is None or name_and_key is None:
                make(item, lambda: None)
                yield item, True
            elif (claim := claims.take(*name_and_key(item))) is None:
                later.append(item)
            else:
                try:
                    with claim:
                        made = not is_there(item)  # between the look and the claim somebody may have finished
                        if made:
                            make(item, claim.confirm)
                        claim.done()
                except TakenOver:
                    later.append(item)
                else:
                    yield item, made
        if later and claims is not None:
            waits(len(later))
            claims.wait(stopped)
        waiting = later


class Claim:
    """What this process holds, until the block ends; left without ``done``, anybody may take it at once.

    Attributes:
        finished: when it was made, by the clock; None before that.

    Raises:
        FileExistsError: somebody made it first.
    """

    def __init__(self, folder: Path, name: str, generation: int, key: str, clock: Callable[[], float]) -> None:
        self.finished: float | None = None
        self._folder, self._name, self._generation, self._clock = folder, name, generation, clock
        self._path = claim_path(folder, name, generation)
        self._key, self._token, self._state, self._beats = key, secrets.token_hex(8), _HELD, 0
        self._lock = threading.Lock()
        handle = os.open(self._path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        with os.fdopen(handle, "wb") as file:
            file.write(self._record())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.finished is None:
            self._say(_FREE)

    def confirm(self) -> None:
        """Raises ``TakenOver`` where it is no longer this process's."""
        if not self.is_ours():
            raise TakenOver(self._name)

    def is_ours(self) -> bool:
        """Whether nobody took it over meanwhile."""
        with self._lock:  # not in the middle of a sign of life
            content = _read(self._path)
        return content is not None and self._wrote(content) and not self._later()

    def done(self) -> None:
        """It is made, and in its place."""
        self.finished = self._clock()
        self._say(_DONE)

    def beat(self) -> None:
        """A sign of life while it is being made."""
        self._say(_HELD)

    def remove(self) -> None:
        """Takes the file away, and before it those of earlier owners: one who wakes up must not find his alone."""
        if not self._later():
            for generation in range(self._generation + 1):
                claim_path(self._folder, self._name, generation).unlink(missing_ok=True)

    def _later(self) -> bool:
        return _read(claim_path(self._folder, self._name, self._generation + 1)) is not None

    def _say(self, state: str) -> None:
        with self._lock:
            if self._state != _HELD:
                return  # a sign of life that came after the end
            self._state = state
            self._beats += 1
            # While the folder is out of reach nothing can be said; whether the claim was lost by it, is_ours tells.
            with contextlib.suppress(OSError), self._path.open("r+b") as file:
                if self._wrote(file.read()):
                    file.seek(0)
                    file.write(self._record())

    def _wrote(self, content: bytes) -> bool:
        return _parse(content).get("token") == self._token

    def _record(self) -> bytes:
        content = {"host": platform.node(), "pid": os.getpid(), "state": self._state, "beats": self._beats,
                   "token": self._token, "key": self._key}  # fmt: skip
        return json.dumps(content).encode().ljust(RECORD_BYTES - 1) + b"\n"


class Claims:
    """The claims of one process on the frames of a folder; a block, which keeps their signs of life going.

    Args:
        out: folder of the frames.
        patience: seconds after which a claim without a sign of life is abandoned.  Twice as long as the folder's
            computers may see each other's changes late is enough.
        clock: seconds that only grow.

    Raises:
        OSError: the folder cannot be written to.
    """

    def __init__(self, out: Path, patience: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder, self._patience, self._clock = out / FOLDER, patience, clock
        self._folder.mkdir(parents=True, exist_ok=True)
        self._seen: dict[Path, tuple[bytes, float]] = {}
        self._current: Claim | None = None
        self._past: deque[Claim] = deque()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._live, name="claims", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join()
        self._clear()

    def take(self, name: str, key: str) -> Claim | None:
        """The claim on an item, or None while somebody else's counts.

        Args:
            name: the same for all who may make it.
            key: of what is to be made; one that was finished with another key is out of date and counts for nothing.
        """
        if self._current is not None and self._current.finished is not None:
            self._past.append(self._current)
        self._current = None
        self._clear()
        generation, last, content = 0, None, b""
        while (found := _read(path := claim_path(self._folder, name, generation))) is not None:
            generation, last, content = generation + 1, path, found
        if last is not None and not self._is_abandoned(last, content, key):
            return None
        try:
            self._current = Claim(self._folder, name, generation, key, self._clock)
        except FileExistsError:
            return None
        return self._current

    def wait(self, stopped: Callable[[], bool]) -> None:
        """Until it is worth to look again at what others hold, or ``stopped``."""
        until = self._clock() + min(LOOK_SECONDS, self._patience / BEATS)
        while self._clock() < until and not stopped():
            time.sleep(STOP_SECONDS)

    def _is_abandoned(self, path: Path, content: bytes, key: str) -> bool:
        record = _parse(content)
        if record.get("state") == _FREE or (record.get("state") == _DONE and record.get("key") != key):
            return True
        now = self._clock()
        before, since = self._seen.get(path, (None, now))
        if before != content:
            self._seen[path] = (content, now)
            return False
        return now - since >= self._patience

    def _clear(self) -> None:
        """Removes the claims of frames that everybody has seen by now."""
        before = self._clock() - KEPT * self._patience
        while self._past and (self._past[0].finished or 0.0) < before:
            self._past.popleft().remove()

    def _live(self) -> None:
        while not self._end.wait(self._patience / BEATS):
            if (current := self._current) is not None:
                current.beat()


def claim_path(folder: Path, name: str, generation: int) -> Path:
    """``.chona-claims/walk_0001.0.json``."""
    return folder / f"{name}.{generation}.json"


def _read(path: Path) -> bytes | None:
    """What is in a file; None where there is none, nothing where it cannot be read just now."""
    try:
        with path.open("rb") as file:
            return file.read(MOST_BYTES)
    except FileNotFoundError:
        return None
    except OSError:
        return b""


def _parse(content: bytes) -> dict[str, Any]:
    """What a claim says; nothing while it is being written."""
    try:
        record = json.loads(content)
    except (ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}
