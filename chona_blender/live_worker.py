"""A worker that stays up: it is handed poses through a pipe and answers with pictures (docs/file-formats.md).

Threads read and write; Blender's main thread only leaves a request and looks what has come. Nothing here touches
Blender's data.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import subprocess
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import IO, Any

from . import worker
from .errors import ChonaError
from .events import clean, read_lines
from .live_frames import Frame, read_answers

KEPT_SECONDS = 60.0
"""How long a worker that nobody asks keeps its model in memory, in case the preview is switched on again."""

ENDING_SECONDS = 0.5
"""How long a process may take to end after its answers have."""

_numbers = itertools.count(1)


class LiveWorker:
    """One process with one model in memory. Its end is final: `error` says why, and a new one takes its place."""

    def __init__(self, command: Sequence[str], environment: dict[str, str] | None = None) -> None:
        """Start the process.

        Raises:
            ChonaError: the program does not start.
        """
        self.was_ready = False
        self.error = ""
        self._changed = threading.Condition()
        self._request: tuple[int, bytes] | None = None
        self._asked = self._answered = 0
        self._frame: Frame | None = None
        self._words: deque[str] = deque(maxlen=worker.KEPT_LINES)
        self._rest_at: float | None = None
        self._closing = False
        self._process = worker.start_process([str(part) for part in command], environment, stdin=subprocess.PIPE)
        worker.running.add(self)
        self._listener = threading.Thread(target=self._listen, args=(self._process.stderr,), daemon=True)
        self._listener.start()
        for target, pipe in ((self._read, self._process.stdout), (self._write, self._process.stdin)):
            threading.Thread(target=target, args=(pipe,), daemon=True).start()

    @property
    def alive(self) -> bool:
        """Whether the process may be asked; with its end `error` is there."""
        return not self._closing

    @property
    def ready(self) -> bool:
        """Whether the model is loaded."""
        return self.was_ready and self.alive

    @property
    def busy(self) -> bool:
        """Whether the newest request has not been answered yet."""
        with self._changed:
            return self._answered < self._asked

    def ask(self, shot: bytes, preset: str, scale: float = 1.0) -> int:
        """Ask for a picture of a shot's first frame; a request that has not been sent yet is dropped for it.

        Args:
            shot: the bytes of a shot file.
            scale: share of the shot's resolution, more than 0 and at most 1.

        Returns:
            the number that the frame will have.
        """
        number = next(_numbers)
        line = {"request": number, "preset": preset, "bytes": len(shot), "scale": scale}
        with self._changed:
            self._request = number, json.dumps(line).encode() + b"\n" + shot
            self._asked, self._rest_at = number, None
            self._changed.notify_all()
        return number

    def newest(self) -> Frame | None:
        """The newest picture that has come, None before the first."""
        with self._changed:
            return self._frame

    def rest(self) -> None:
        """Nobody looks at present: unless it is asked again within `KEPT_SECONDS`, the process ends."""
        with self._changed:
            self._rest_at = time.monotonic() + KEPT_SECONDS
            self._changed.notify_all()

    def close(self) -> None:
        """End the process at once and wait until it is gone. There is nothing that it could leave half done."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        worker.kill_group(self._process)
        self._process.wait()
        worker.running.discard(self)

    def _next_request(self) -> bytes | None:
        """Waits for a request; None when no more are to be sent."""
        with self._changed:
            while self._request is None and not self._closing:
                left = None if self._rest_at is None else self._rest_at - time.monotonic()
                if left is not None and left <= 0.0:
                    self._closing = True
                else:
                    self._changed.wait(left)
            if self._closing or self._request is None:
                return None
            _, content = self._request
            self._request = None
            return content

    def _write(self, pipe: IO[bytes]) -> None:
        try:
            with pipe:
                while (content := self._next_request()) is not None:
                    pipe.write(content)
                    pipe.flush()
        except OSError:  # the worker has ended: `_read` sees it too, and tells
            return

    def _listen(self, pipe: IO[bytes]) -> None:
        with pipe:
            for line in read_lines(pipe):
                self._words.append(clean(line).rstrip())

    def _read(self, pipe: IO[bytes]) -> None:
        problem = ""
        with pipe:
            try:
                for event, frame in read_answers(pipe, self._words.append):
                    self._take(event, frame)
            except (ChonaError, OSError) as error:
                problem = str(error)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    if self._process.wait(ENDING_SECONDS) != 0:  # its death is the reason, in the middle of an answer
                        problem = ""
                worker.kill_group(self._process)
        code = self._process.wait()
        self._listener.join(timeout=2.0)
        worker.running.discard(self)
        with self._changed:
            self.error = "" if self._closing else problem or worker.last_words(code, self._words)
            self._closing, self._answered = True, self._asked
            self._changed.notify_all()

    def _take(self, event: dict[str, Any], frame: Frame | None) -> None:
        kind = event["event"]
        with self._changed:
            number = event.get("request", self._asked)  # what names no request answers all that wait
            if number > self._asked:
                raise ChonaError(f"the worker's answer is not understood: there is no request {number}")
            if kind == "ready":
                self.was_ready = True
            elif kind in {"frame", "error", "skipped"}:
                self._answered = max(self._answered, number)
                self.error = event.get("message") or "the worker cannot render this" if kind == "error" else ""
            if frame is not None:
                self._frame = frame
