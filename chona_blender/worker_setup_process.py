"""Makes the worker's environment: a venv, wheels downloaded into it one by one, a check. `worker_setup` starts it.

Run by the Python that the environment is made of, which is not Blender's: standard library alone, no relative imports.
Its only argument is the plan in JSON; JSON lines on stdout tell how far it is. Nothing here makes the environment count
as set up: it stays in the folder `PARTIAL` until Blender's side has judged the check. Killed at any time, it leaves
whole wheels there, and the next run goes on from them.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.parse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

PARTIAL = "worker.partial"
LOCK = "worker.lock"
SOURCE_OPTIONS = ("index-url", "extra-index-url", "find-links", "no-index")
REDIRECTING = {
    *("PIP_CONSTRAINT", "PIP_DRY_RUN", "PIP_NO_BINARY", "PIP_NO_DEPS", "PIP_PREFIX", "PIP_PYTHON"),
    *("PIP_REPORT", "PIP_REQUIREMENT", "PIP_ROOT", "PIP_TARGET", "PIP_USER"),
}
"""Settings that would have pip install something else or elsewhere; where it finds packages stays the user's."""
BATCH_BYTES = 20 * 10**6
POLL_SECONDS = 0.25
UNREACHABLE = re.compile(
    r"NameResolutionError|NewConnectionError|Failed to establish|ProxyError|SSLError|ConnectTimeout|ReadTimeout|"
    r"Max retries|Connection (?:refused|reset)|RemoteDisconnected"
)


class Failed(Exception):
    """Set-up cannot go on. Its words are for the user; `code` is the process's exit code."""

    def __init__(self, words: str, code: int = 1) -> None:
        super().__init__(words)
        self.code = code


@dataclass(frozen=True)
class Plan:
    """What `worker_setup` hands over.

    Attributes:
        folder: the add-on's own folder, which exists.
        requirements: what to install, `name==version`; torch is among them.
        constraints: file with the versions of what those need, or "".
        torch_index: where torch alone comes from, unless pip is configured with sources of its own; "" for no other.
        torch_index_asked: the user has named that index, so it goes before pip's configuration.
        wheels: folder to install from without the network, or "".
        probe: arguments of the environment's Python that make it describe itself in one JSON line.
        bytes: size of each package's wheel by its name in lower case, where it has been measured.
    """

    folder: str
    requirements: list[str]
    constraints: str
    torch_index: str
    torch_index_asked: bool
    wheels: str
    probe: list[str]
    bytes: dict[str, int] = field(default_factory=dict)

    @property
    def same(self) -> dict[str, Any]:
        """What must be equal for wheels of an earlier run to be used again."""
        return {"python": sys.version, "requirements": self.requirements, "index": self.torch_index}


def say(**event: object) -> None:
    """One line of the progress protocol."""
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


def environment_python(environment: Path) -> Path:
    """The interpreter of a virtual environment."""
    return environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


class SetUp:
    """One run. `run` returns what the `result` event tells."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.partial = Path(plan.folder) / PARTIAL
        self.environment, self.wheels = self.partial / "environment", self.partial / "wheels"
        self.temporary = self.partial / "temporary"

    def run(self) -> dict[str, Any]:
        """All steps, in order."""
        self._begin()
        say(event="progress", job="setup", done=0, total=0, message="making the environment")
        self._make_environment()
        if self.plan.wheels:
            self._install_from(Path(self.plan.wheels))
        else:
            self._install_files(self._download())
        say(event="progress", job="setup", done=0, total=0, message="checking the environment")
        check = self._check()
        shutil.rmtree(self.temporary, ignore_errors=True)
        return {
            "environment": str(self.environment),
            "check": check,
            "packages": installed(self.environment),
            "wheels": {path.name: path.stat().st_size for path in sorted(self.wheels.glob("*.whl"))},
            "bytes": folder_bytes(self.environment),
        }

    def _begin(self) -> None:
        """Keep the wheels of an interrupted run of the same plan, and nothing else of it."""
        note = self.partial / "plan.json"
        try:
            kept = json.loads(note.read_text("utf-8")) == self.plan.same
        except (OSError, ValueError):
            kept = False
        for path in (self.environment, self.temporary, *(() if kept else (self.wheels,))):
            if path.exists():
                shutil.rmtree(path)
        for path in (self.wheels, self.temporary):
            path.mkdir(parents=True, exist_ok=True)
        note.write_text(json.dumps(self.plan.same), "utf-8")

    def _make_environment(self) -> None:
        try:
            import ensurepip  # noqa: F401 - Debian leaves it out
            import venv
        except ImportError as error:
            raise Failed(f"{sys.executable} cannot make environments ({error}); choose another Python", 2) from error
        try:
            venv.EnvBuilder(with_pip=True, symlinks=os.name != "nt").create(self.environment)
        except subprocess.CalledProcessError as error:
            words = error.output.decode(errors="replace") if isinstance(error.output, bytes) else str(error.output)
            raise Failed(f"pip cannot be put into {self.environment}: {last_line(words.splitlines())}") from error

    def _download(self) -> list[Path]:
        """Wheels of everything that is needed, one after the other."""
        index = self.plan.torch_index
        torch = next((each for each in self.plan.requirements if each.startswith("torch==")), "")
        apart = index and torch and (self.plan.torch_index_asked or not self._configured_sources())
        if apart and not list(self.wheels.glob(torch.replace("==", "-") + "[-+]*.whl")):
            self._fetch([torch], "downloading torch", ["--index-url", index], (0, self._expected("torch")))
        say(event="progress", job="setup", done=0, total=0, message="finding out what is needed")
        report = self.temporary / "report.json"
        self._pip(
            "install", "--dry-run", "--ignore-installed", "--quiet", "--report", str(report),
            "--only-binary", ":all:", "--find-links", str(self.wheels), *self._what(),
        )  # fmt: skip
        needed = [Needed.of(each) for each in json.loads(report.read_text("utf-8"))["install"]]
        total, done = sum(self._expected(each.name) for each in needed), 0
        for batch in batches([(each, self._expected(each.name)) for each in needed]):
            absent = [each for each in batch if not (self.wheels / each.file).is_file()]
            size = sum(self._expected(each.name) for each in batch)
            if absent:
                others = f" and {len(absent) - 1} more" if len(absent) > 1 else ""
                words = f"downloading {absent[0].name}{others}, package {needed.index(absent[0]) + 1} of {len(needed)}"
                self._fetch([each.requirement for each in absent], words, [], (done, done + size), total)
            done += size
        return [self.wheels / each.file for each in needed]

    def _expected(self, name: str) -> int:
        """Bytes of a wheel, a megabyte where it was not measured."""
        return self.plan.bytes.get(name.lower().replace("_", "-"), 10**6)

    def _configured_sources(self) -> bool:
        """Whether the user's pip takes packages from elsewhere than PyPI: a mirror, a folder, no network."""
        lines = self._pip("config", "list")
        return any(line.partition("=")[0].endswith(tuple(f".{name}" for name in SOURCE_OPTIONS)) for line in lines)

    def _what(self) -> list[str]:
        return [*self.plan.requirements, *(["--constraint", self.plan.constraints] if self.plan.constraints else [])]

    def _fetch(
        self, requirements: list[str], words: str, options: list[str], span: tuple[int, int], total: int | None = None
    ) -> None:
        """Download wheels; they get their place only when they are whole.

        Args:
            span: bytes of everything before them, and with them.
            total: bytes of everything; None where this is all.
        """
        folder, (before, after) = self.temporary / "fetched", span

        def progress() -> None:
            done = min(before + folder_bytes(self.temporary), after)
            say(event="progress", job="setup", done=done, total=total or after, message=words)

        self._pip(
            "download", "--no-deps", "--no-cache-dir", "--quiet", "--only-binary", ":all:",
            "--dest", str(folder), *options, *requirements, watch=progress,
        )  # fmt: skip
        for path in list(folder.iterdir()):
            path.replace(self.wheels / path.name)

    def _install_files(self, files: list[Path]) -> None:
        self._install(len(files), "--no-deps", *map(str, files))

    def _install_from(self, folder: Path) -> None:
        if not list(folder.glob("*.whl")):
            raise Failed(f"the folder {folder} holds no wheels (*.whl); fill it with `pip download`", 2)
        self._install(0, "--find-links", str(folder), *self._what())

    def _install(self, count: int, *what: str) -> None:
        """Install without the network and without the user's configuration, which could name other wheels."""
        most = [0]

        def progress() -> None:
            number = most[0] = max(len(installed(self.environment)), most[0])  # pip takes its own old setuptools away
            words = (
                f"installing package {min(number + 1, count)} of {count}" if count else f"{number} packages installed"
            )
            say(event="progress", job="setup", done=number if count else 0, total=count, message=words)

        options = ("--isolated", "install", "--no-index", "--no-cache-dir", "--only-binary", ":all:")
        self._pip(*options, *what, watch=progress)

    def _check(self) -> dict[str, Any]:
        """What the new environment says of itself."""
        command = [str(environment_python(self.environment)), *self.plan.probe]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        sys.stderr.write(done.stderr)
        for line in done.stdout.splitlines():
            if line.startswith("{"):
                return json.loads(line)
        said = last_line(done.stderr.splitlines())
        raise Failed(f"the new environment does not answer (code {done.returncode}): {said}")

    def _pip(self, *arguments: str, watch: Callable[[], None] | None = None) -> list[str]:
        """pip in the new environment; its lines. It takes the user's configuration, but for where it installs."""
        variables = {key: value for key, value in os.environ.items() if key.upper() not in REDIRECTING}
        variables |= {name: str(self.temporary) for name in ("TMPDIR", "TEMP", "TMP")}  # /tmp can be small
        command = [str(environment_python(self.environment)), "-I", "-m", "pip", *arguments]
        command += ["--no-input", "--disable-pip-version-check"]
        lines: list[str] = []
        with child(command, variables) as process:
            reader = threading.Thread(target=_read, args=(process, lines), daemon=True)
            reader.start()
            while process.poll() is None:
                if watch is not None:
                    watch()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(POLL_SECONDS)
            reader.join(timeout=5.0)
        if process.returncode != 0:
            raise Failed(pip_words(lines, process.returncode))
        return lines


@dataclass(frozen=True)
class Needed:
    """A package that pip has chosen."""

    name: str
    version: str
    file: str

    @property
    def requirement(self) -> str:
        return f"{self.name}=={self.version}"

    @classmethod
    def of(cls, entry: dict[str, Any]) -> Needed:
        """From an entry of pip's installation report."""
        path = urllib.parse.unquote(urllib.parse.urlsplit(entry["download_info"]["url"]).path)
        return cls(entry["metadata"]["name"], entry["metadata"]["version"], path.rpartition("/")[2])


def batches(sized: list[tuple[Needed, int]]) -> Iterator[list[Needed]]:
    """Neighbours that are small together: each start of pip takes seconds, and what is interrupted begins anew."""
    batch: list[Needed] = []
    size = 0
    for each, its_size in sized:
        if batch and size + its_size > BATCH_BYTES:
            yield batch
            batch, size = [], 0
        batch.append(each)
        size += its_size
    if batch:
        yield batch


@contextlib.contextmanager
def child(command: list[str], variables: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """A process that does not outlive this one's interest in it."""
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, encoding="utf-8", errors="replace", env=variables,
    )  # fmt: skip
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def _read(process: subprocess.Popen[str], lines: list[str]) -> None:
    for line in process.stdout or ():
        lines.append(line.rstrip())
        sys.stderr.write(line)


def pip_words(lines: list[str], code: int) -> str:
    """Why pip failed, and what can be done."""
    text = "\n".join(lines)
    if "No space left on device" in text or "[Errno 28]" in text:
        return "the disk is full; free some space and set up again, it goes on where it stopped"
    if UNREACHABLE.search(text):
        host = re.search(r"host='([^']+)'", text)
        return (
            f"{host[1] if host else 'the package index'} cannot be reached; check the network and its proxy, "
            "name a mirror in pip's configuration (PIP_INDEX_URL), or set up from a folder of wheels"
        )
    absent = re.search(r"(?:No matching distribution found for|Cannot install) ([^\s,]+)", text)
    if absent:
        version = ".".join(map(str, sys.version_info[:2]))
        return (
            f"there is no wheel of {absent[1]} for Python {version} on {sys.platform} where pip looks; "
            "choose another Python, or another place to install from"
        )
    return f"pip ended with code {code}: {last_line([line for line in lines if 'ERROR' in line] or lines)}"


def last_line(lines: list[str]) -> str:
    """The last that was said."""
    return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")


def installed(environment: Path) -> list[str]:
    """`name-version` of each package that is there whole: pip writes RECORD last."""
    folders = [*environment.glob("lib/python*/site-packages"), *environment.glob("Lib/site-packages")]
    whole = [path.parent.name for each in folders for path in each.glob("*.dist-info/RECORD")]
    return sorted(name.removesuffix(".dist-info") for name in whole if not name.startswith(("pip-", "setuptools-")))


def folder_bytes(folder: Path) -> int:
    """Size of a folder's files; those that go away meanwhile are not counted."""
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):
                total += os.lstat(os.path.join(place, name)).st_size  # noqa: PTH118 - tens of thousands of files
    return total


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """At most one set-up at a time. The system gives the lock back when a process ends, however it ends."""
    with (folder / LOCK).open("a+b") as file:
        try:
            if os.name == "nt":
                import msvcrt

                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
            else:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise Failed(f"another set-up works in {folder}; wait until it has ended", 2) from error
        yield


def _stop(number: int, _frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)


def main(text: str) -> int:
    """0 done, 1 failed, 2 wrong input; the reason is an `error` event."""
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, _stop)
    plan = Plan(**json.loads(text))
    started = time.monotonic()
    try:
        with locked(Path(plan.folder)):
            result = SetUp(plan).run()
    except (Failed, OSError) as error:
        say(event="error", job="setup", message=str(error))
        return error.code if isinstance(error, Failed) else 1
    say(event="result", job="setup", seconds=time.monotonic() - started, **result)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
