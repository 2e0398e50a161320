"""The worker and the jobs with real processes. Arguments: worker's Python, a Python without torch."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

from operation_scene import say

import chona_blender
from chona_blender import jobs, worker, worker_check
from chona_blender.errors import ChonaError

good, bare = (Path(part) for part in sys.argv[1:3])
protocol = Path(__file__).with_name("operation_protocol.py")
chona_blender.register()


def job(*arguments: str) -> jobs.Job:
    return jobs.Job("Test", [str(good), str(protocol), *arguments])


def outcome(run: jobs.Job) -> dict:
    return {
        "status": run.status,
        "code": run.code,
        "error": run.error,
        "result": run.result,
        "share": run.share,
        "text": run.text,
        "lines": list(run.worker.lines),
    }


def finished(*arguments: str) -> dict:
    return outcome(jobs.run_blocking(job(*arguments)))


def cancelled(*arguments: str, after: float = 0.0) -> dict:
    """Cancel once the worker has begun; how long that takes, and whether the process is gone."""
    run = job(*arguments)
    while run.total == 0 and not run.poll():
        time.sleep(0.02)
    begun = time.monotonic()
    run.cancel()
    while not run.poll():
        time.sleep(0.02)
    return outcome(run) | {"seconds": time.monotonic() - begun, "alive": alive(run)}


def alive(run: jobs.Job) -> bool:
    return subprocess.run(["ps", "-p", str(run.worker._process.pid)], capture_output=True, check=False).returncode == 0


def farm_stops() -> dict:
    """SIGTERM to this process while it waits, as a render farm sends it."""
    run = job("steps", "200")
    threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM)).start()
    jobs.run_blocking(run)
    return outcome(run) | {"alive": alive(run)}


def closed() -> dict:
    """The add-on is switched off while a worker runs."""
    run = job("steps", "200")
    time.sleep(0.5)
    chona_blender.unregister()
    gone = not alive(run)
    chona_blender.register()
    return {"gone": gone}


def error_of(command: list[str]) -> str:
    try:
        worker.Worker(command)
    except ChonaError as error:
        return str(error)
    return ""


os.environ["PYTHONHOME"], os.environ["PYTHONSTARTUP"] = "/nonexistent", "/nonexistent"
answer = {
    "environment": {key: value for key, value in worker.worker_environment().items() if key.startswith("PYTHON")},
    "sources": str(worker.sources_folder()),
    "steps": finished("steps", "5"),
    "noise": finished("noise"),
    "wrong input": finished("error"),
    "crash": finished("crash"),
    "killed": finished("killed"),
    "cancelled": cancelled("steps", "200"),
    "farm": farm_stops(),
    "closed": closed(),
    "not there": error_of([str(good.parent / "nothing"), "-V"]),
    "check good": worker_check.check_worker(str(good)).summary,
    "check bare": worker_check.check_worker(str(bare)).text,
    "check quick": worker_check.check_worker(str(bare), load=False).good,
    "found": str(worker.find_python(str(good))[0]),
}
worker.GRACE_SECONDS = 0.5
answer["deaf"] = cancelled("deaf")
os.environ[worker.PYTHON_VARIABLE] = str(good)
answer["variable"] = [str(part) for part in worker.find_python()]
os.environ[worker.PYTHON_VARIABLE] = str(good.parent / "nothing")
answer["wrong variable"] = worker_check.check_worker().summary
say(answer)
