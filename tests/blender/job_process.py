"""A process that tells of a job as a worker does, without its seconds of start: for tests of who looks on.

Arguments: the job's file, and its events in JSON. It ends after a last event, else it waits to be killed or asked.
"""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path

from chona_model.formats.job_file import END_EVENTS, JobFile

path, *events = sys.argv[1:]
asked = threading.Event()
job = JobFile(Path(path), ["bake"], asked.set)
for event in map(json.loads, events):
    job.take(event)
    if event["event"] in END_EVENTS:
        job.close()
        sys.exit(0 if event["event"] == "result" else 1)
asked.wait()
job.take({"event": "cancelled", "job": "bake", "written": 7, "skipped": 0})
job.close()
sys.exit(1)
