"""Starting: commands, a worker that is ready, and a pose change that comes back as a picture from a warm one."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import time
from dataclasses import replace
from statistics import median
from typing import IO, Any

import numpy as np

from benchmarks.common import Bench, held_shot, save
from chona_model.data.dataset import View
from chona_model.formats.shot import write_shot_to

POSES = 12
WIDTH, HEIGHT = 256, 192


def measure(bench: Bench) -> None:
    """Writes ``startup.json``. Kernels must have been compiled before, as after the first run on a machine."""
    views = bench.dataset(bench.test).views
    chona = [sys.executable, "-m", "chona_model"]
    info = median(_process([*chona, "info", str(bench.model)]) for _ in range(5))
    _worker_ready(bench, chona)
    ready = [_worker_ready(bench, chona) for _ in range(3)]
    names = bench.seen()[0].skeleton.names
    latency = {preset: round(1e3 * _latency(bench, chona, views, names, preset), 1) for preset in ("draft", "preview")}
    save("startup", {"info_seconds": round(info, 3), "worker_ready_seconds": round(median(ready), 2),
                     "size": [WIDTH, HEIGHT], "pose_to_frame_ms": latency})  # fmt: skip


def _process(command: list[str]) -> float:
    began = time.perf_counter()
    subprocess.run(command, capture_output=True, check=True)
    return time.perf_counter() - began


def _start(bench: Bench, chona: list[str]) -> tuple[subprocess.Popen[bytes], IO[bytes], IO[bytes]]:
    worker = subprocess.Popen(
        [*chona, "serve", "--model", str(bench.model)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert worker.stdin is not None
    assert worker.stdout is not None
    json.loads(worker.stdout.readline())
    return worker, worker.stdin, worker.stdout


def _worker_ready(bench: Bench, chona: list[str]) -> float:
    """Seconds from starting the process to its saying that it is ready."""
    began = time.perf_counter()
    worker, inbox, _ = _start(bench, chona)
    seconds = time.perf_counter() - began
    inbox.close()
    worker.wait()
    return seconds


def _latency(bench: Bench, chona: list[str], views: tuple[View, ...], names: tuple[str, ...], preset: str) -> float:
    """Median seconds from a new pose in this process to its pixels in this process, everything counted."""
    worker, inbox, outbox = _start(bench, chona)
    seconds = []
    for number in range(POSES):
        view = views[(4 * number + 1) % len(views)]
        began = time.perf_counter()
        shot = _shot(view, names)
        line = {"request": number, "preset": preset, "bytes": len(shot), "scale": 1.0}
        inbox.write(json.dumps(line).encode() + b"\n" + shot)
        inbox.flush()
        event: dict[str, Any] = json.loads(outbox.readline())
        pixels = np.frombuffer(outbox.read(event["bytes"]), "<f4").reshape(HEIGHT, WIDTH, 5)
        seconds.append(time.perf_counter() - began)
        assert pixels[..., 3].max() > 0.5
    inbox.close()
    worker.wait()
    return median(seconds[2:])


def _shot(view: View, names: tuple[str, ...]) -> bytes:
    """A shot of one view at the preview's size."""
    camera = replace(view.camera.scaled(WIDTH / view.camera.width), width=WIDTH, height=HEIGHT)
    stream = io.BytesIO()
    write_shot_to(stream, held_shot(view.pose, camera, names))
    return stream.getvalue()
