"""What a farm moves and does besides rendering: sizes of models, shots and frames, and processor time to handle them.

Processor time, not the clock's: of one frame or file it is the same however many others run.  docs/scale.md is
computed from it.
"""

from __future__ import annotations

import json
import struct
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.common import Bench, filling, held_shot, save
from chona_model.bake import frame_hash
from chona_model.blur import SHARP
from chona_model.claims import Claims
from chona_model.formats.exr import FrameHeader, is_finished, write_frame
from chona_model.formats.model_file import file_hash, read_header
from chona_model.formats.shot import Shot, read_shot, write_shot
from chona_model.frame import ShotRenderer
from chona_model.passes import DEFAULT_PASSES, PASSES, Passes
from chona_model.settings import RENDER_PRESETS

WIDTH, HEIGHT = 1920, 1080
CLOSE = 1.6
"""Times closer than in the capture: a figure from head to foot."""
MANY_FRAMES, MANY_IDENTITIES, CLAIMS = 10_000, 1_000, 500
EVERYTHING = Passes.of(PASSES)


def measure(bench: Bench) -> None:
    """Writes ``farm.json``."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save("farm", {
            "model": _model(bench), "header": _header(bench, folder), "shot": _shot(bench, folder),
            "frame": _frame(bench, folder), "claim_cpu_ms": _claim(folder),
        })  # fmt: skip


def _cpu(runs: int, *works: Callable[[], object]) -> list[float]:
    """Median milliseconds of processor time of each of ``works``; the first round does not count."""
    rows: list[list[float]] = [[] for _ in works]
    for turn in range(runs + 1):
        for row, work in zip(rows, works, strict=True):
            began = time.process_time()
            work()
            if turn:
                row.append(time.process_time() - began)
    return [1e3 * median(row) for row in rows]


def _model(bench: Bench) -> dict[str, Any]:
    """Bytes of a model file by what they are of, and how fast a bake makes sure of it."""
    with bench.model.open("rb") as file:
        header = json.loads(file.read(struct.unpack("<Q", file.read(8))[0]))
    sizes: dict[str, int] = defaultdict(int)
    for tensor, facts in header.items():
        if tensor != "__metadata__":
            kind = tensor.partition(".")[0]
            first, last = facts["data_offsets"]
            sizes[kind if kind in ("person", "object") else "shared"] += last - first
    described = read_header(bench.model)
    (seconds,) = _cpu(bench.runs, lambda: file_hash(bench.model))
    return {
        "bytes": bench.model.stat().st_size, "person": sizes["person"] // max(len(described.persons), 1),
        "object": sizes["object"] // max(len(described.objects), 1), "shared": sizes["shared"],
        "hash_cpu_ms": round(seconds, 1),
    }  # fmt: skip


def _header(bench: Bench, folder: Path) -> dict[str, Any]:
    """Reading the header of a model of many identities: a copy of this one's, its identities repeated."""
    with bench.model.open("rb") as file:
        header = json.loads(file.read(struct.unpack("<Q", file.read(8))[0]))
    content = json.loads(header["__metadata__"]["chona"])
    for kind, key in (("persons", "person"), ("objects", "object")):
        name, facts = next(iter(content[kind].items()))
        content[kind] = {f"{name}{index}": facts for index in range(MANY_IDENTITIES)}
        for tensor in [tensor for tensor in header if tensor.startswith(f"{key}.{name}.")]:
            facts = header.pop(tensor)
            for index in range(MANY_IDENTITIES):
                header[tensor.replace(f".{name}.", f".{name}{index}.", 1)] = facts
    header["__metadata__"] = {"chona": json.dumps(content)}
    text = json.dumps(header).encode()
    path = folder / "many.safetensors"
    data = max(facts["data_offsets"][1] for name, facts in header.items() if name != "__metadata__")
    with path.open("wb") as file:
        file.write(struct.pack("<Q", len(text)) + text)
        file.truncate(8 + len(text) + data)  # tensors that nobody reads here
    (taken,) = _cpu(3, lambda: read_header(path))
    return {"identities": MANY_IDENTITIES, "bytes": len(text), "read_cpu_ms": round(taken, 1)}


def _shot(bench: Bench, folder: Path) -> dict[str, Any]:
    """A frame of a long shot: bytes, reading it, and its hash."""
    shot, path = _held(bench, MANY_FRAMES), folder / "long.shot.npz"
    write_shot(path, shot)
    final = RENDER_PRESETS["final"]
    read, hashed = _cpu(3, lambda: read_shot(path), lambda: [frame_hash(shot, i, final) for i in range(100)])
    return {
        "frames": MANY_FRAMES, "bytes_per_frame": path.stat().st_size // MANY_FRAMES, "read_cpu_ms": round(read, 1),
        "hash_cpu_us_per_frame": round(1e3 * hashed / 100, 1),
    }  # fmt: skip


def _frame(bench: Bench, folder: Path) -> dict[str, Any]:
    """A frame at 1080p: bytes with the usual passes and with all, writing it, and making sure that it is whole."""
    actor, _ = bench.seen()
    rows: dict[str, Any] = {"size": [WIDTH, HEIGHT]}
    shot = _held(bench, 1)
    for name, passes in (("usual", DEFAULT_PASSES), ("all", EVERYTHING)):
        layers = ShotRenderer((actor,), shot, RENDER_PRESETS["final"], passes, 0.0, SHARP).render(0)
        path, header = folder / f"{name}.exr", FrameHeader("m" * 64, "s" * 64, "final", "{}", 1.0, 1)
        names = layers.cryptomatte.names if layers.cryptomatte else ()
        written, checked = _cpu(
            bench.runs,
            lambda path=path, layers=layers, header=header: write_frame(path, layers, header),
            lambda path=path, passes=passes, names=names: is_finished(path, "m" * 64, "s" * 64, passes, names),
        )
        rows |= {
            name: {"passes": list(passes.names), "bytes": path.stat().st_size, "write_cpu_ms": round(written, 1),
                   "check_cpu_ms": round(checked, 1)},
            "covered_share": round(float((layers.combined[..., 3] > 0).mean()), 3),
        }  # fmt: skip
    return rows


def _claim(folder: Path) -> float:
    """Taking a claim on a frame and letting it go as done, on this disk."""
    claims = Claims(folder, 60.0)
    began = time.process_time()
    for index in range(CLAIMS):
        claim = claims.take(f"held_{index:04d}", "key")
        assert claim is not None
        with claim:
            claim.confirm()
            claim.done()
    return round(1e3 * (time.process_time() - began) / CLAIMS, 3)


def _held(bench: Bench, frames: int) -> Shot:
    actor, view = bench.seen()
    small = actor.render(view.pose, view.camera, RENDER_PRESETS["draft"])
    rows, columns = np.nonzero(small.alpha > 0.5)
    camera = filling(view.camera, WIDTH, HEIGHT, CLOSE, np.array([columns.mean(), rows.mean()]))
    return held_shot(view.pose, camera, actor.skeleton.names, frames)
