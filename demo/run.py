"""The whole job from nothing: capture in Blender, train, pose, bake, composite, and compare with Cycles.

Every stage is a process of its own (Blender and torch must not share one) and leaves its results in the output folder.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Sizes:
    """How large and how long.

    Attributes:
        width, height: of captured and baked images, pixels; capture_samples, samples: of Cycles.
        captured: frames of each of the two performances; frames: of the shot; minutes: of training.
    """

    width: int = 320
    height: int = 240
    capture_samples: int = 12
    samples: int = 16
    captured: int = 10
    frames: int = 16
    minutes: float = 4.0


QUICK = Sizes(192, 144, 8, 8, 4, 4, 0.5)


class StageError(RuntimeError):
    """A stage ended with an error; its own output says which."""


def main(words: Sequence[str] | None = None) -> int:
    """Runs all stages; returns the exit code."""
    parser = argparse.ArgumentParser(prog="demo", description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--blender-python", type=Path, help="a Python with bpy; default: .venv-blender")
    parser.add_argument("--minutes", type=float, help="of training")
    parser.add_argument("--quick", action="store_true", help="small pictures, short training")
    arguments = parser.parse_args(words)
    sizes = QUICK if arguments.quick else Sizes()
    minutes = arguments.minutes or sizes.minutes
    blender = arguments.blender_python or _default_blender()
    if blender is None or not blender.exists():
        sys.stderr.write(
            f"chona: no Python with bpy at {blender or '.venv-blender'}; run 'make demo', or name one with "
            "--blender-python\n"
        )
        return 2
    out = arguments.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    try:
        seconds = run(out, blender, sizes, minutes)
    except StageError as error:
        sys.stderr.write(f"chona: {error}\n")
        return 1
    sys.stdout.write(summary(out, seconds))
    return 0


def run(out: Path, blender: Path, sizes: Sizes, minutes: float) -> dict[str, float]:
    """All stages; returns the seconds of each."""
    worker = Path(sys.executable)
    capture, trained = out / "capture", out / "run"
    size = ["--width", sizes.width, "--height", sizes.height]
    seconds: dict[str, float] = {}
    _stage(seconds, "capture", blender, "-m", "demo.capture", "--folder", capture, *size,
           "--samples", sizes.capture_samples, "--frames", sizes.captured)  # fmt: skip
    _stage(seconds, "train", worker, "-m", "chona_model", "train", "--data", capture, "--format", "blender",
           "--out", trained, "--preset", "fast", "--minutes", minutes)  # fmt: skip
    shutil.copyfile(trained / "model.safetensors", out / "model.safetensors")
    for folder in ("frames", "composite", "reference"):
        shutil.rmtree(out / folder, ignore_errors=True)
    _stage(seconds, "shoot", blender, "-m", "demo.shoot", "--model", out / "model.safetensors", "--out", out,
           "--worker-python", worker, *size, "--samples", sizes.samples, "--frames", sizes.frames)  # fmt: skip
    parts = out / "seconds.json"
    seconds |= {f"shoot: {name}": value for name, value in json.loads(parts.read_text()).items()}
    parts.unlink()
    from demo.compare import compare, write_report

    start = time.perf_counter()
    scores = compare(out)
    seconds["compare"] = time.perf_counter() - start
    write_report(out, scores, seconds)
    return seconds


def _stage(seconds: dict[str, float], name: str, python: Path, *words: object) -> None:
    sys.stdout.write(f"demo: {name} …\n")
    sys.stdout.flush()
    start = time.perf_counter()
    # Blender's modules know nothing of the worker's environment, nor the other way round.
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        [str(python), *(str(word) for word in words)],
        cwd=ROOT,
        env=environment | {"PYTHONPATH": str(ROOT)},
        check=False,
    )
    seconds[name] = time.perf_counter() - start
    if done.returncode:
        raise StageError(f"the stage '{name}' of the demo ended with exit code {done.returncode}; its output is above")


def _default_blender() -> Path | None:
    folder = ROOT / ".venv-blender"
    found = [path for path in (folder / "bin" / "python", folder / "Scripts" / "python.exe") if path.exists()]
    return found[0] if found else None


def summary(out: Path, seconds: dict[str, float]) -> str:
    """What was made, in words."""
    report = json.loads((out / "report.json").read_text())["scores"]
    lines = [f"  {name:18s} {value:6.1f} s" for name, value in seconds.items()]
    return "\n".join(
        [
            "demo: done",
            *lines,
            f"  against Cycles' render of the same frames: {report['psnr']:.2f} dB, SSIM {report['ssim']:.4f}; over "
            f"the figure's pixels {report['psnr_figure']:.2f} dB",
            f"  look at {out / 'contact_sheet.png'}, {out / 'demo.gif'}; open {out / 'scene.blend'}",
            "",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
