"""Starts a bake as the add-on does, says its process, and waits to be killed."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from chona_blender import worker
from chona_blender.jobs import Job

python, *words = sys.argv[1:]
job = Job("Bake", worker.chona_command(Path(python), words))
until = time.monotonic() + 120
while job.total <= 0 and not job.poll():
    assert time.monotonic() < until, "the bake does not begin"
    time.sleep(0.05)
print(json.dumps({"pid": job.worker._process.pid, "error": job.error}), flush=True)
while True:
    time.sleep(0.1)
    job.poll()
