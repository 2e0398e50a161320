"""What workers say when they are well: an event of every kind, and the stream of every job."""

from __future__ import annotations

import json
import struct
from typing import Any

PACKAGES: dict[str, Any] = {
    "python": [3, 11, 9], "executable": "/usr/bin/python3", "missing": [], "broken": {}, "versions": {},
    "notes": [["CUDA", "no card", ""]],
    "chona_model": "/opt/chona/chona_model/__init__.py", "torch": "2.7.0", "torch_cuda": None, "cuda": "",
}  # fmt: skip

START = {"event": "start", "job": "bake", "total": 50}
PROGRESS = {"event": "progress", "job": "bake", "done": 3, "total": 50, "seconds": 2.1, "eta": 32.9,
            "message": "walk_0003.exr"}  # fmt: skip
STEP = {"event": "progress", "job": "train", "done": 12, "total": 100, "seconds": 2.1, "eta": None, "loss": 0.0125,
        "psnr": 19.03, "message": "step 12"}  # fmt: skip
BAKED = {"event": "result", "job": "bake", "written": 48, "skipped": 2, "repeated": 5, "seconds": 34.0, "out": "frames",
         "left_out": {"model_loaded": True, "out_of_picture": [{"actor": "Robin", "name": "crate", "frames": 3}]},
         "max_error": {"asked": 0.01, "error": 0.02, "unsettled": 3, "pixels": 900, "refined": 40, "rungs": 4,
                       "rays": 9000}}  # fmt: skip
ESTIMATED = {"event": "result", "job": "estimate", "frames": 20, "factor": None, "start_seconds": 2.5,
             "presets": {name: {"seconds_per_frame": 0.25, "total_seconds": 7.5, "psnr": None, "ssim": None}
                         for name in ("draft", "preview", "final", "exact")}}  # fmt: skip
CHECKED = {"event": "result", "job": "check-data", "sound": True, "headline": "Blender captures: 2 sequences",
           "persons": ["Sub01"], "objects": ["box01"], "views": 24, "gaps": {}, "warnings": ["a mask is empty"],
           "sequences": [{"name": "lift", "views": 24, "checked": 3, "joints_inside": 0.97, "objects_inside": None,
                          "sheet": None}]}  # fmt: skip
CAPTURED = {"event": "result", "job": "capture", "written": 40, "skipped": 2, "warnings": ["a bone was dropped"],
            "words": "40 images, about 3 min"}  # fmt: skip
TRAINED = {"event": "result", "job": "train", "model": "run/model.safetensors", "steps": 100, "seconds": 60.5}
PROBED = {"event": "result", "job": "check", **PACKAGES}
SET_UP = {"event": "result", "job": "setup", "seconds": 90.0, "environment": "/home/me/worker", "check": PACKAGES,
          "bytes": 123456789, "packages": ["numpy-2.2"], "wheels": {"numpy.whl": 1000}}  # fmt: skip
FAILED = {"event": "error", "job": "bake", "code": 2, "message": "model.safetensors: expected version 1, found 9"}
READY = {"event": "ready", "job": "serve", "seconds": 2.1}
SKIPPED = {"event": "skipped", "request": 6}
REFUSED = {"event": "error", "request": 8, "message": "cannot read the shot"}

WIDTH, HEIGHT = 6, 4
PIXELS = struct.pack(f"<{WIDTH * HEIGHT * 5}f", *[0.25] * (WIDTH * HEIGHT * 5))
FRAME = {"event": "frame", "request": 7, "preset": "draft", "width": WIDTH, "height": HEIGHT, "seconds": 0.055,
         "bytes": len(PIXELS)}  # fmt: skip

EVENTS = (START, PROGRESS, STEP, BAKED, ESTIMATED, CHECKED, CAPTURED, TRAINED, PROBED, SET_UP, FAILED, READY, SKIPPED,
          REFUSED, FRAME, {"event": "cancelled", "job": "bake", "written": 3})  # fmt: skip
RESULTS = {"bake": BAKED, "estimate": ESTIMATED, "data": CHECKED, "capture": CAPTURED, "train": TRAINED,
           "probe": PROBED, "setup": SET_UP}  # fmt: skip
LOG = tuple(
    {"step": step, "seconds": 0.1 * step, "loss": 0.1 / step, "psnr": 15.0 + step}
    | ({"preview_psnr": 18.5} if step % 2 else {})
    for step in (1, 2, 3, 10, 20)
)


def line(event: Any) -> bytes:
    """As a worker writes it."""
    return json.dumps(event).encode() + b"\n"


def answers() -> bytes:
    """What a live worker writes for three requests."""
    return line(READY) + line(SKIPPED) + line(FRAME) + PIXELS + line(REFUSED) + line(FRAME) + PIXELS
