"""Spoiled output of real children, given to every job of the add-on. Arguments: folder of streams, model, scratch."""

from __future__ import annotations

import resource
import shutil
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
from operation_scene import empty_scene, say

import chona_blender
from chona_blender import (
    actions,
    capturing,
    cost_table,
    diagnosis,
    estimates,
    jobs,
    measuring,
    messages,
    train_data,
    train_queue,
    train_rows,
    train_view,
    worker_check,
    worker_setup,
)
from chona_blender.errors import ChonaError
from chona_blender.live_worker import LiveWorker
from chona_blender.pick_up import baked_words
from chona_blender.train_job import TrainJob

streams, model, scratch = (Path(part) for part in sys.argv[1:4])
chona_blender.register()
scene = empty_scene()
scene.chona.model_path = str(model)
bpy.ops.chona.create_rig()
in_threads: list[str] = []
threading.excepthook = lambda raised: in_threads.append(f"{raised.exc_type.__name__}: {raised.exc_value}"[:300])
ends: Counter = Counter()
LAST_REQUEST = 10


def memory() -> int:
    """Most bytes that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def shown(words: str) -> None:
    """Where Blender shows it: the status bar, a property of a list's row, a report on the clipboard."""
    bpy.context.workspace.status_text_set(words)
    bpy.context.workspace.status_text_set(None)
    scene.chona.name = words
    messages.remember_error(words)
    diagnosis.report_text().encode()


def ended(job: jobs.Job) -> jobs.Job:
    """Wait as a modal operator does, and look at what the panels draw."""
    jobs.board.last = job
    while not job.poll():
        shown(f"{job.title}: {job.text}")
        assert 0.0 <= job.share <= 1.0
        time.sleep(0.001)
    shown(job.text)
    shown(job.error)
    job.report.encode()
    ends[job.status] += 1
    return job


def cat(path: Path) -> list[str]:
    """A child that writes a file to its standard output."""
    return ["/bin/cat", str(path)]


class DataJob(train_data.CheckDataJob):
    """The add-on's own, with a child of ours."""

    def __init__(self, path: Path) -> None:
        self.key, self.place = (str(path), "blender"), TemporaryDirectory()
        jobs.Job.__init__(self, "Check", cat(path))


def bake(path: Path) -> None:
    job = ended(jobs.Job("Bake", cat(path)))
    if job.status == jobs.DONE:
        shown(baked_words(job.result) + actions.error_words(job.result))


def estimate(path: Path) -> None:
    job = ended(measuring.EstimateJob("Estimate", cat(path), TemporaryDirectory(), estimates.facts_of(scene)))
    if job.status == jobs.DONE:
        for each in measuring.keep_estimate(scene, job):
            shown(each)
        for row in cost_table.table(scene).rows:
            shown(f"{row.name} {row.quality} {row.frame} {row.total}")
        shown(cost_table.time_of_bake(scene))


def data(path: Path) -> None:
    job = DataJob(path)
    found = train_data.keep(ended(job))
    shown(" ".join([found.headline, found.problem, *found.warnings[:10]]))
    for each in found.sequences:
        shares = [share for share in (each.joints_inside, each.objects_inside) if share is not None]
        shown(" ".join([each.name, *(f"{share:.0%}" for share in shares)]))


def capture(path: Path) -> None:
    job = ended(jobs.Job("Capture", cat(path)))
    job.facts = ()
    if job.status == jobs.DONE:
        shown(capturing.keep_estimate(scene, job))


def train(path: Path) -> None:
    train_rows.trainings().rows.clear()
    row = train_rows.trainings().rows.add()
    row.key, row.name, row.state, row.run_folder = "key", "run", train_rows.RUNNING, str(scratch / "run")
    (scratch / "run").mkdir(exist_ok=True)
    ended(TrainJob("Train", cat(path), scratch / "run", "key", train_queue.follow))
    shown(row.words)


def probe(path: Path) -> None:
    job = ended(jobs.Job("Check worker", cat(path)))
    report = worker_check.judge(path, "the test", job.result or None, job.code, list(job.worker.lines))
    shown(report.summary)
    report.text.encode()


def setup(path: Path) -> None:
    job = ended(worker_setup.SetUpJob("Set up worker", cat(path)))
    if job.status == jobs.DONE:
        worker_setup.finish(worker_setup.Choice(), job)


def live(path: Path) -> None:
    worker = LiveWorker(["/bin/sh", "-c", 'read request; exec cat "$0"', str(path)])
    while worker.ask(b"shot", "draft") < LAST_REQUEST:  # of the messages
        pass
    while worker.alive:
        time.sleep(0.001)
    assert worker.error and not worker.busy, [worker.error, worker.busy]
    shown(worker.error)
    ends["live pictures"] += worker.newest() is not None
    worker.close()


def follow(path: Path, name: str) -> None:
    """A file in a training's folder, as the panel's picture is made of it."""
    run = scratch / "followed"
    run.mkdir(exist_ok=True)
    shutil.copy(path, run / name)
    if name == train_view.PREVIEW:
        (run / train_view.LOG).write_text('{"step": 1, "loss": 0.1, "psnr": 20.0}\n')
    train_view.choose(run)


READERS: dict[str, Callable[[Path], None]] = {
    "bake": bake, "estimate": estimate, "data": data, "capture": capture, "train": train, "probe": probe,
    "setup": setup, "live": live, "log": lambda path: follow(path, train_view.LOG),
    "picture": lambda path: follow(path, train_view.PREVIEW),
}  # fmt: skip


def watched(job: jobs.Job, seconds: float) -> dict:
    """A child that does not stop: how long a look takes, how much memory it costs, and how soon it is ended."""
    before, begun, longest, seen = memory(), time.monotonic(), 0.0, 0
    while time.monotonic() - begun < seconds:
        look = time.monotonic()
        assert not job.poll(), job.error
        shown(job.text)
        longest, seen = max(longest, time.monotonic() - look), seen + (job.done > 0)
        time.sleep(0.02)
    ending = time.monotonic()
    job.close()
    return {
        "grown": memory() - before, "longest look": longest, "seen": seen, "seconds to end": time.monotonic() - ending,
        "longest kept": max(map(len, job.worker.lines), default=0),
    }  # fmt: skip


raised: list[str] = []
slowest, longest, before, number = 0.0, 0.0, memory(), 0
for number, path in enumerate(sorted(streams.iterdir()), start=1):  # noqa: B007
    begun = time.process_time(), time.monotonic()
    try:
        READERS[path.name.partition("-")[0]](path)
    except ChonaError as error:
        shown(messages.sentence(error))
    except Exception as error:
        raised.append(f"{path.name}: {type(error).__name__}: {error}"[:500])
    slowest = max(slowest, time.process_time() - begun[0])
    longest = max(longest, time.monotonic() - begun[1])
answer = {"raised": raised[:10], "read": number, "slowest": [slowest, longest], "grown": memory() - before}
answer["endless"] = watched(jobs.Job("Endless", ["/bin/cat", "/dev/zero"]), 2.0)
answer["flood"] = watched(jobs.Job("Flood", ["/usr/bin/yes", '{"event": "progress", "done": 1, "total": 2}']), 2.0)
quiet = jobs.run_blocking(jobs.Job("Quiet", ["/bin/true"]))
answer["no result"] = [quiet.status, quiet.error]
answer["in threads"], answer["ends"] = in_threads[:10], ends
chona_blender.unregister()
say(answer)
