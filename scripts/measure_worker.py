"""Measures what Set Up Worker downloads and installs: ``python scripts/measure_worker.py [cpu] [cuda]``.

Makes the environment as the add-on does, in a temporary folder, and writes chona_blender/worker_sizes.json. It needs
the network and, for CUDA, several gigabytes on the disk. Run it again after a change of constraints.txt; systems that
are not measured again keep their entry. ``--torch-index URL`` takes torch from elsewhere than PyTorch's own index, and
`PIP_…` variables hold as they do for the add-on.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parent.parent
SIZES = ROOT / "chona_blender" / "worker_sizes.json"


def load(name: str) -> ModuleType:
    """One of the add-on's modules that need no Blender; its package would import bpy."""
    import importlib.util

    spec = importlib.util.spec_from_file_location(f"chona_measure.{name}", ROOT / "chona_blender" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def measure(device: str, torch_index: str) -> dict:
    """{"python", "installed": bytes on the disk, "wheels": {package: bytes to download}, "versions": {package: …}}."""
    package = ModuleType("chona_measure")
    package.__path__ = [str(ROOT / "chona_blender")]
    sys.modules[package.__name__] = package
    packages, process = load("worker_packages"), load("worker_setup_process")
    with tempfile.TemporaryDirectory() as folder:
        plan = process.Plan(
            folder=folder,
            requirements=[each.requirement for each in packages.packages(ROOT)],
            constraints=str(packages.constraints(ROOT)),
            torch_index=torch_index or packages.TORCH_INDEX[device],
            torch_index_asked=bool(torch_index),
            wheels="",
            probe=["-c", 'print("{}")'],
        )
        command = [sys.executable, "-I", process.__file__, json.dumps(asdict(plan))]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        last = json.loads(done.stdout.splitlines()[-1])
        if done.returncode != 0:
            raise SystemExit(f"measure_worker: {last['message']}")
    names = {file: file.split("-")[0].lower().replace("_", "-") for file in last["wheels"]}
    return {
        "python": platform.python_version(),
        "installed": last["bytes"],
        "wheels": {names[file]: size for file, size in last["wheels"].items()},
        "versions": {names[file]: file.split("-")[1].partition("+")[0] for file in last["wheels"]},
    }


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("devices", nargs="*", choices=["cpu", "cuda"], default=["cpu", "cuda"])
    parser.add_argument("--torch-index", default="", metavar="URL")
    arguments = parser.parse_args()
    table = json.loads(SIZES.read_text("utf-8"))
    entry = table["systems"].setdefault(f"{platform.system()} {platform.machine()}", {})
    for device in arguments.devices:
        entry[device] = measure(device, arguments.torch_index)
    SIZES.write_text(json.dumps(table, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
