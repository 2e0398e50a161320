"""Sets the worker up from tiny wheels, as an installed extension. Arguments: zip, good wheels, wheels without torch."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import bpy
from operation_scene import say

sys.path[:] = [part for part in sys.path if not (Path(part) / "chona_blender").is_dir()]
package, good, lacking = (Path(part) for part in sys.argv[1:4])
name = "bl_ext.user_default.chona"
bpy.ops.extensions.package_install_files(filepath=str(package), repo="user_default", enable_on_install=True)
commands, home, setup, check, worker = (
    sys.modules[f"{name}.{each}"] for each in ("commands", "worker_home", "worker_setup", "worker_check", "worker")
)


def command(*arguments: object) -> dict:
    """The exit code and the words of a command."""
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        code = commands.main([str(each) for each in arguments])
    return {"code": code, "out": out.getvalue(), "words": errors.getvalue()}


def stand_in(lines: str) -> str:
    """A Python that differs from this one by a few lines that run first."""
    path = home.folder(create=True) / f"python-{len(lines)}"
    path.write_text(f'#!/bin/sh\nshift 2\nexec "{sys.executable}" -I -c "{lines}\n$1"\n')
    path.chmod(0o755)
    return str(path)


def living(group: int) -> list[str]:
    """Processes of a group that have not ended; the dead of killed parents wait for their burial as zombies."""
    listed = subprocess.run(["ps", "-eo", "pgid=,stat="], capture_output=True, text=True, check=True).stdout
    pairs = [line.split() for line in listed.splitlines()]
    return [state for number, state in pairs if number == str(group) and not state.startswith("Z")]


def killed(stop: signal.Signals) -> dict:
    """A set-up is ended while pip installs; what counts as set up then."""
    job = setup.start(setup.Choice(wheels=str(good)))
    while not list((home.folder() / "worker.partial" / "environment").glob("lib/*/site-packages/pip")):
        time.sleep(0.02)
    os.killpg(job.worker._process.pid, stop) if stop == signal.SIGKILL else job.cancel()
    begun = time.monotonic()
    while not job.poll():
        time.sleep(0.02)
    seconds = time.monotonic() - begun
    while (alive := living(job.worker._process.pid)) and time.monotonic() - begun < 20.0:
        time.sleep(0.2)
    return {"alive": alive, "status": job.status, "seconds": seconds, "python": str(home.python())}


answer: dict = {"online": bpy.app.online_access, "folder": str(home.folder())}
answer["offline"] = command("setup-worker")
answer["no folder"] = command("setup-worker", "--wheels", good / "nothing")
answer["no ensurepip"] = command(
    "setup-worker", "--wheels", good, "--python", stand_in("import sys; sys.modules['ensurepip'] = None")
)
answer["old"] = command(
    "setup-worker", "--wheels", good, "--python", stand_in("import sys; sys.version_info = (3, 9, 1, 'final', 0)")
)
answer["no python"] = command("setup-worker", "--wheels", good, "--python", "/bin/true")
answer["before"] = str(home.python())
answer["killed"] = killed(signal.SIGKILL)
answer["cancelled"] = killed(signal.SIGTERM)
answer["set up"] = command("setup-worker", "--wheels", good)
answer["python"] = str(home.python())
answer["found"] = [str(each) for each in worker.find_python()]
answer["ready"] = json.loads((home.folder() / "worker" / home.READY).read_text())
answer["left"] = sorted(path.name for path in home.folder().iterdir() if not path.name.startswith("python-"))
answer["check"] = command("check")
answer["for cuda"] = command("check", "--device", "cuda")
answer["lacking"] = command("setup-worker", "--wheels", lacking)
answer["still"] = check.check_worker().good
bpy.context.preferences.addons[name].preferences.setup_wheels = str(good)
answer["operator without wheels"] = ""
try:
    bpy.ops.chona.set_up_worker(build="cpu")
except RuntimeError as error:
    answer["operator without wheels"] = str(error)
answer["needs"] = {device: setup.outlook(setup.Choice(device, wheels=str(good))).lines for device in ("cpu", "cuda")}

probe = {"python": [3, 11, 7], "missing": [], "broken": {}, "notes": [], "cuda": "", "torch": "2.13.0"}
own = str(worker.sources_folder() / "chona_model" / "__init__.py")
for case, more in (
    ("old torch", {"versions": {"torch": "2.5.1"}, "chona_model": own}),
    ("newer is fine", {"versions": {"torch": "10.0+cu999"}, "chona_model": own}),
    ("foreign", {"versions": {}, "chona_model": "/elsewhere/chona_model/__init__.py"}),
):
    answer[case] = check.judge(Path("/python"), "here", probe | more, 0, []).problem
card = {
    "versions": {},
    "chona_model": own,
    "torch_cuda": "13.0",
    "notes": [["CUDA", "the driver is too old", "update"]],
}
for device in ("cuda", "auto"):
    found = check.judge(Path("/python"), "here", probe | card, 0, [], device)
    answer[f"no card, {device}"] = [found.summary, *found.notes]

occupied = home.occupied()
(home.folder() / "worker" / "bin" / "python").unlink()  # the Python that it was made of is uninstalled
answer["base gone"] = check.check_worker().summary
answer["remove"] = command("remove-worker")
answer["removed"] = [occupied > 10**6, home.occupied(), str(home.python())]
answer["remove again"] = command("remove-worker")
say(answer)
