"""``chona.log``: which commands ran, how they ended and where they failed; the last half a megabyte of it.

It lies in ``$CHONA_LOGS``, else in ``.chona/logs`` in the home folder, and never stands in the way of the work.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shlex
import time
import traceback
from collections.abc import Sequence
from logging.handlers import RotatingFileHandler
from pathlib import Path

NAME = "chona.log"
FILE_BYTES, OLD_FILES = 1 << 17, 3


def journal_folder() -> Path:
    """Where the log lies."""
    given = os.environ.get("CHONA_LOGS")
    return Path(given) if given else Path.home() / ".chona" / "logs"


class _Quiet(RotatingFileHandler):
    def handleError(self, record: logging.LogRecord) -> None:
        """A full disk is told of by what cannot be done without it."""


def note(text: str, error: BaseException | None = None) -> None:
    """Writes a line, and below it where an error came from."""
    with contextlib.suppress(OSError, RuntimeError, MemoryError):  # no home folder, or one that cannot be written to
        folder = journal_folder()
        folder.mkdir(parents=True, exist_ok=True)
        handler = _Quiet(folder / NAME, maxBytes=FILE_BYTES, backupCount=OLD_FILES, encoding="utf-8", delay=True)
        try:
            trace = "" if error is None else "\n" + "".join(traceback.format_exception(error)).rstrip()
            line = f"{time.strftime('%Y-%m-%d %H:%M:%S')} {os.getpid()} {text}{trace}"
            handler.emit(logging.makeLogRecord({"msg": line}))
        finally:
            handler.close()


def note_start(words: Sequence[str]) -> None:
    """A command begins."""
    note(f"begins: {shlex.join(words)}")


def note_end(words: Sequence[str], code: int) -> None:
    """A command has ended."""
    note(f"ends with {code}: {words[0]}")
