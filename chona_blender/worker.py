"""The worker: `python -m chona_model …` in a process of its own, spoken to in JSON lines.

Nothing here touches Blender's data, and the reader threads only keep what they read: it is looked at in
Blender's main thread. The worker's Python is another one than Blender's: torch lives there, and a crash or an
out-of-memory ends only the worker.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import IO, Any, Protocol

from . import worker_home
from .errors import ChonaError
from .events import clean, parse_event, read_lines

PYTHON_VARIABLE = "CHONA_WORKER_PYTHON"
KEPT_LINES = 80
GRACE_SECONDS = 10.0
UNTIL_CLOSED = "--until-closed"
"""Option of a worker that ends with Blender, however that ends."""


def sources_folder() -> Path:
    """The folder that holds the package chona_model: `worker/` in the extension, the repository's root beside it."""
    package = Path(__file__).resolve().parent
    for folder in (package / "worker", package.parent):
        if (folder / "chona_model" / "__init__.py").is_file():
            return folder
    raise ChonaError(f"the worker's sources (chona_model) are not beside {package}; install the CHONA extension again")


def find_python(preference: str = "") -> tuple[Path, str]:
    """The worker's Python and where it was named. A named one must exist: it is never skipped silently.

    Raises:
        ChonaError: the named one, or what the add-on's own environment was made of, is gone.
    """
    named = [
        (preference, "the add-on's preferences or by --python"),
        (os.environ.get(PYTHON_VARIABLE, ""), f"the variable {PYTHON_VARIABLE}"),
    ]
    for text, origin in named:
        if text:
            path = Path(text).expanduser()
            if path.is_dir():
                path = next((p for p in _interpreters(path) if p.is_file()), path)
            if not path.is_file():
                raise ChonaError(
                    f"the worker's Python {text}, named in {origin}, does not exist; "
                    "expected a Python 3.11 or newer with torch: correct it there, or clear it and press Set Up Worker"
                )
            return path, origin
    own = worker_home.python()
    if own is not None:
        return own, "Set Up Worker"
    for path in _interpreters(sources_folder() / ".venv"):
        if path.is_file():
            return path, "the environment beside the sources"
    return Path(sys.executable), "Blender's own Python, for want of another"


def _interpreters(environment: Path) -> tuple[Path, ...]:
    """Where a virtual or conda environment keeps its interpreter, on every system."""
    return tuple(environment / part for part in ("bin/python", "bin/python3", "Scripts/python.exe", "python.exe"))


def worker_environment() -> dict[str, str]:
    """Blender's environment without its Python's settings; PYTHONPATH names the worker's sources alone."""
    kept = {
        key: value
        for key, value in os.environ.items()
        if not key.upper().startswith("PYTHON") and key != "__PYVENV_LAUNCHER__"
    }
    kept["PYTHONPATH"] = str(sources_folder())
    kept["PYTHONSAFEPATH"] = "1"  # a file random.py in the current folder must not stand in for the library's
    kept["PYTHONUNBUFFERED"] = "1"
    kept["PYTHONIOENCODING"] = "utf-8"
    return kept


def start_process(command: Sequence[str], environment: dict[str, str] | None, **pipes: Any) -> subprocess.Popen[Any]:
    """Start a worker in a session or process group of its own, its output in pipes.

    Args:
        environment: default `worker_environment()`.
        pipes: further arguments of Popen: standard input, text or bytes, output that goes elsewhere.

    Raises:
        ChonaError: the program does not start.
    """
    own_group: dict[str, Any] = (
        {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
        if sys.platform == "win32"
        else {"start_new_session": True}
    )
    try:
        return subprocess.Popen(
            command,
            env=worker_environment() if environment is None else environment,
            **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **pipes},
            **own_group,
        )
    except OSError as error:
        raise ChonaError(
            f"the worker's Python {command[0]} does not start: {error.strerror or error}; "
            "name another one in the preferences"
        ) from error


def kill_group(process: subprocess.Popen[Any]) -> None:
    """Kill a worker with all that it has started; harmless when it has ended."""
    if process.poll() is not None:  # its number may belong to another process by now
        return
    with contextlib.suppress(OSError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)


def last_words(code: int, lines: Iterable[str]) -> str:
    """How a worker ended and the last that it said, from its exit code and its lines."""
    said = next((line for line in reversed(list(lines)) if line.strip()), "it said nothing")
    how = f"was ended by signal {-code}" if code < 0 else f"ended with code {code}"
    how += {-6: " (out of memory?)", -9: " (out of memory?)", -7: " (was a file that it read cut off?)"}.get(code, "")
    return f"the worker {how}: {said}"


class Worker:
    """One running worker process. Call `close` always, it is harmless when all has ended."""

    goes_on = False
    """Whether the process goes on when this is closed."""

    def __init__(self, command: Sequence[str], environment: dict[str, str] | None = None) -> None:
        self.command = [str(part) for part in command]
        self.lines: deque[str] = deque(maxlen=KEPT_LINES)
        self.cancelled_at: float | None = None
        self._events: dict[str, dict[str, Any]] = {}
        self._guard = threading.Lock()
        self._process = start_process(
            self.command,
            environment,
            # The worker ends when this end of the pipe is closed, which the system does even when Blender crashes.
            stdin=subprocess.PIPE if UNTIL_CLOSED in self.command else subprocess.DEVNULL,
        )
        self._threads = [
            threading.Thread(target=self._read_events, args=(self._process.stdout,), daemon=True),
            threading.Thread(target=self._read_words, args=(self._process.stderr,), daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        running.add(self)

    def _read_events(self, stream: IO[bytes]) -> None:
        with contextlib.suppress(ValueError), stream:
            for line in read_lines(stream):
                event = parse_event(line)
                if event is None:
                    self.lines.append(clean(line).rstrip())
                    continue
                with self._guard:
                    self._events.pop(event["event"], None)
                    self._events[event["event"]] = event

    def _read_words(self, stream: IO[bytes]) -> None:
        with contextlib.suppress(ValueError), stream:
            for line in read_lines(stream):
                self.lines.append(clean(line).rstrip())

    def events(self) -> list[dict[str, Any]]:
        """What the worker has said since the last call: of each kind the newest, in the order in which they came."""
        with self._guard:
            found, self._events = list(self._events.values()), {}
        return found

    def code(self) -> int | None:
        """The exit code once the process has ended and all it said has been read, else None."""
        if self._process.poll() is None:
            return None
        for thread in self._threads:
            thread.join(timeout=2.0)
        self._let_go()
        running.discard(self)
        return self._process.returncode

    def _let_go(self) -> None:
        """Close what the worker would see closed if Blender ended."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def wait(self, seconds: float | None = None) -> int | None:
        """Wait for the end; None when it has not come within `seconds`."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=seconds)
        return self.code()

    def last_words(self, code: int) -> str:
        """How the process ended, and the last that it said."""
        return last_words(code, self.lines)

    def cancel(self) -> None:
        """Ask the worker to stop after its current step. `press` ends it when it does not."""
        if self.cancelled_at is None:
            self.cancelled_at = time.monotonic()
            if sys.platform == "win32":  # it has no signals: terminating would lose the step, and a checkpoint
                self._let_go()
                return
            with contextlib.suppress(OSError):
                self._process.terminate()

    def press(self) -> None:
        """Kill a worker that was cancelled and has not ended within the grace time."""
        if self.cancelled_at is not None and time.monotonic() - self.cancelled_at > GRACE_SECONDS:
            kill_group(self._process)

    def close(self, grace: float = 2.0) -> None:
        """End the process whatever it does, and wait until it is gone."""
        if self._process.poll() is None:
            self.cancel()
            try:
                self._process.wait(timeout=grace)
            except subprocess.TimeoutExpired:
                kill_group(self._process)
                self._process.wait()
        self.code()


class Closable(Protocol):
    """What `close_all` ends."""

    def close(self) -> None:
        """End the process, and wait until it is gone, or leave it to itself where it is meant to go on."""


running: set[Closable] = set()
"""Every worker that was started and has not been seen to end."""


def close_all() -> None:
    """End every worker that is not meant to go on: when Blender quits or the add-on is switched off."""
    for worker in list(running):
        worker.close()


def chona_command(python: Path, arguments: Sequence[str]) -> list[str]:
    """The command line of a `chona` job that reports in JSON lines."""
    return [str(python), "-m", "chona_model", *arguments, "--progress", "json", UNTIL_CLOSED]


def detached_command(python: Path, arguments: Sequence[str], record: Path) -> list[str]:
    """The command line of a `chona` job that reports in a file, and does not end with Blender."""
    return [str(python), "-m", "chona_model", *arguments, "--progress-file", str(record)]
