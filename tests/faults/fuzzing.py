"""Runs families of spoiled input in a process of its own: limited memory, a watchdog, and only clear errors allowed.

``python fuzzing.py MODULE FAMILY EXAMPLES FOLDER`` tries so many; it prints what broke the promise and fails. The same
are tried again with the same CHONA_SEED, 0 if there is none.
"""

from __future__ import annotations

import importlib
import os
import resource
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from hypothesis import strategies as st

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
MORE_MEMORY = 1 << 30
"""Bytes beyond what the process has when the first input comes."""
SEED = int(os.environ.get("CHONA_SEED", "0"))
CPU_SECONDS, SECONDS = 5.0, 60.0
"""Of one input: a busy machine may let it wait."""

Family = Callable[[Path], tuple[st.SearchStrategy[Any], Callable[[Any], object]]]
"""Makes valid input in a folder; gives what spoils it, and what reads it."""


class HungError(BaseException):
    """An input took too long; no reader catches it."""


def endured(read: Callable[[], object]) -> bool:
    """Whether input was read (True) or refused with a clear error (False); anything else is raised.

    Raises:
        AssertionError: the error is none of the program's own, says too little or too much, or memory ran out.
    """
    try:
        read()
        return True
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None:
            assert not isinstance(cause, MemoryError), f"memory ran out behind {error!r:.300}"
            cause = cause.__cause__
        module = type(error).__module__.partition(".")[0]
        assert module in ("chona_model", "chona_blender"), f"a raw {type(error).__name__}: {error!s:.300}"
        message = str(error)
        assert 20 <= len(message) <= 2000, f"a message of {len(message)} characters: {message[:300]}"
        return False


def run(module: str, family: str, examples: int, folder: Path) -> str:
    """Tries a family; ``AssertionError`` with the smallest input found where the promise is broken."""
    strategy, read = getattr(importlib.import_module(module), family)(folder)
    counts = {True: 0, False: 0}

    def hang(_signal: int, _frame: object) -> None:
        raise HungError(f"more than {CPU_SECONDS:g} s")

    signal.signal(signal.SIGPROF, hang)
    signal.signal(signal.SIGALRM, hang)
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    if pages:
        limit = pages * os.sysconf("SC_PAGE_SIZE") + MORE_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))

    @seed(SEED)
    @settings(
        max_examples=examples, deadline=None, database=None,
        suppress_health_check=list(HealthCheck), phases=[Phase.generate, Phase.shrink], print_blob=False,
        report_multiple_bugs=False, verbosity=Verbosity.quiet,
    )  # fmt: skip
    @given(strategy)
    def tried(content: Any) -> None:
        signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        try:
            counts[endured(lambda: read(content))] += 1
        except HungError as error:
            raise AssertionError(str(error)) from error
        except Exception:
            whole = content[-1] if isinstance(content, tuple) else content
            (folder / "failing").write_bytes(whole)  # the last one is the smallest
            raise
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.setitimer(signal.ITIMER_REAL, 0)

    tried()
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    assert grown < 3 * MORE_MEMORY, f"{grown} bytes were in use"
    return f"{family}: {counts[False]} refused, {counts[True]} read, seed {SEED}"


def start(module: str, family: str, examples: int, folder: Path) -> str:
    """``run`` in a process of its own; its report. Crashes and hangs of that process fail the test."""
    command = [sys.executable, str(HERE / "fuzzing.py"), module, family, str(examples), str(folder)]
    paths = [str(ROOT), str(HERE), str(ROOT / "tests" / "model"), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, cwd=ROOT, timeout=120 + 2 * examples, check=False
    )
    assert done.returncode == 0, f"exit {done.returncode}\n{done.stdout[-3000:]}\n{done.stderr[-6000:]}"
    return done.stdout


if __name__ == "__main__":
    try:
        sys.stdout.write(run(sys.argv[1], sys.argv[2], int(sys.argv[3]), Path(sys.argv[4])) + "\n")
    except Exception as error:  # its notes repeat the whole input
        sys.exit("".join(traceback.format_tb(error.__traceback__))[-4000:] + f"{type(error).__name__}: {error}"[:1000])
