"""The file of a job that nobody listens to: whole, bounded, locked while the job runs, and the way to end it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from chona_blender import job_record
from chona_model.formats import job_file
from chona_model.formats.folder_lock import FolderBusyError
from chona_model.formats.job_file import MOST_LOG, JobFile, bake_file, is_running, train_file
from chona_model.owner import this_process

ROOT = Path(__file__).parents[3]
DEAF = """
import sys, time
from pathlib import Path
from chona_model.formats import job_file
job_file.STOP_SECONDS = 0.3
job_file.JobFile(Path(sys.argv[1]), [], lambda: None)
time.sleep(100)
"""


def until(holds: Callable[[], object]) -> None:
    end = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


def progress(done: int) -> dict:
    return {"event": "progress", "job": "bake", "done": done, "total": 10**6, "message": f"walk_{done:04d}.exr"}


def test_both_sides_mean_the_same_files(tmp_path: Path) -> None:
    assert job_record.bake_record(tmp_path, "a.b") == bake_file(tmp_path, "a.b")
    assert job_record.train_record(tmp_path) == train_file(tmp_path)
    assert job_record.VERSION == job_file.VERSION


def test_what_a_job_says_is_read(tmp_path: Path) -> None:
    """It does not grow, whoever looks meets all of it, and nothing else is left."""
    path = bake_file(tmp_path, "walk.v2")
    job = JobFile(path, ["bake", "--out", "ü"], lambda: None)
    first = job_record.read_record(path)
    assert first is not None and first.events == [] and first.is_here and first.pid == os.getpid()
    assert job_record.is_running(path) is True and is_running(path)
    job.take({"event": "start", "job": "bake", "total": 10**6})
    for done in range(20_000):
        job.take(progress(done))
        if done % 1000 == 0:
            assert job_record.read_record(path) is not None
    until(lambda: job_record.read_record(path).progress == progress(19_999))
    assert path.stat().st_size < 1000
    job.take({"event": "result", "job": "bake", "written": 3, "skipped": 4})
    assert job_record.read_record(path).end == {"event": "result", "job": "bake", "written": 3, "skipped": 4}
    job.close()
    assert job_record.is_running(path) is False and not is_running(path)
    assert json.loads(path.read_text("utf-8"))["owner"]["started"] == this_process().started
    assert {each.name for each in tmp_path.iterdir()} == {path.name, path.with_suffix(".log").name}
    job_record.clear(path)
    assert not list(tmp_path.iterdir())


def test_a_second_job_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_file, "LOCK_SECONDS", 0.1)
    path = train_file(tmp_path)
    job = JobFile(path, ["train"], lambda: None)
    before = path.read_bytes()
    with pytest.raises(FolderBusyError, match=r"belongs to another job that runs already; wait .* \.chona-train\.stop"):
        JobFile(path, ["train"], lambda: None)
    assert path.read_bytes() == before and is_running(path)
    job.close()
    JobFile(path, ["train"], lambda: None).close()


def test_the_log_does_not_grow(tmp_path: Path) -> None:
    path = train_file(tmp_path)
    job = JobFile(path, ["train"], lambda: None)
    log = path.with_suffix(".log")
    with log.open("a", encoding="utf-8") as file:
        file.write("a warning\n" * (MOST_LOG // 5))
        file.flush()
        until(lambda: log.stat().st_size == 0)
        file.write("its last words\n")
    assert job_record.last_lines(path) == ["its last words"]
    job.close()


def test_a_folder_that_is_taken_away_is_not_made_again(tmp_path: Path) -> None:
    path = train_file(tmp_path / "run")
    job = JobFile(path, ["train"], lambda: None)
    (tmp_path / "run").rename(tmp_path / "elsewhere")
    job.take({"event": "error", "job": "train", "code": 1, "message": "the folder is gone"})
    job.close()
    assert not (tmp_path / "run").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="looks at signals")
def test_who_does_not_end_is_ended(tmp_path: Path) -> None:
    """A step that takes longer than the grace time; also where the request for it came before the job."""
    path = train_file(tmp_path)
    job_record.ask_to_end(path)
    with subprocess.Popen([sys.executable, "-c", DEAF, path], cwd=ROOT, start_new_session=True) as process:
        until(lambda: is_running(path) and not path.with_suffix(".stop").exists())
        assert process.poll() is None, "what was asked of the job before is not asked of this one"
        job_record.ask_to_end(path)
        assert process.wait(30) == -9
    record = job_record.read_record(path)
    assert record is not None and record.end is None and not is_running(path)


@pytest.mark.parametrize("content", [
    b"", b"{", b"[]", b"3", b"\xff\xfe", b"[" * 100_000, b'{"version": 1}', b'{"version": 2, "owner": {}}',
    b'{"version": 1, "owner": {"host": "a", "pid": "x"}, "since": "", "written": "", "start": null, "progress": null,'
    b' "end": null}',
    b'{"version": 1, "owner": {"host": "a", "pid": 1}, "since": "", "written": "", "start": null,'
    b' "progress": {"event": "progress", "done": "many"}, "end": null}',
    b'{"version": 1, "owner": {"host": "a", "pid": 1}, "since": "", "written": "", "start": null,'
    b' "progress": {"event": "progress", "done": NaN}, "end": null}',
    b'{"version": 1, "owner": {"host": "a", "pid": 1}, "since": "", "written": "", "start": [], "progress": null,'
    b' "end": null}',
])  # fmt: skip
def test_what_no_job_has_written_is_no_record(tmp_path: Path, content: bytes) -> None:
    path = train_file(tmp_path)
    path.write_bytes(content)
    assert job_record.read_record(path) is None
    assert job_record.read_record(tmp_path / "nowhere" / path.name) is None
    assert job_record.is_running(tmp_path / "nowhere" / path.name) is False
