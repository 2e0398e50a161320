"""Logs that stay small, and the bundle for bug reports, which tells what is needed and no secrets."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from cli_files import write_capture, write_header, write_tiny_shot
from fault_runs import environment
from PIL import Image

from chona_model import journal
from chona_model.bundle import without_secrets
from chona_model.train.log import TrainingLog

pytestmark = pytest.mark.faults


def test_a_training_log_stays_small_and_keeps_its_shape(tmp_path: Path) -> None:
    most = 50
    with TrainingLog(tmp_path, 0, most) as log:
        for step in range(1, 2001):
            log.write(step, step / 10, {"loss": 1.0 / step, "psnr": 1.0})
    steps = [json.loads(line)["step"] for line in (tmp_path / "log.jsonl").read_text("utf-8").splitlines()]
    assert most / 2 <= len(steps) <= most
    assert steps[0] == 1 and steps[-1] > 1900 and steps == sorted(set(steps))
    assert np.diff(steps).max() <= 2 * np.diff(steps).min() + 2, "a part of the curve is gone"


def test_a_long_log_that_is_continued_stays_small(tmp_path: Path) -> None:
    for done in range(0, 300, 30):
        with TrainingLog(tmp_path, done, 50) as log:
            for step in range(done + 1, done + 31):
                log.write(step, step / 10, {"loss": 1.0})
    lines = (tmp_path / "log.jsonl").read_text("utf-8").splitlines()
    assert len(lines) <= 50 and json.loads(lines[-1])["step"] > 270


def test_the_journal_stays_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CHONA_LOGS", str(tmp_path))
    for number in range(2000):
        journal.note(f"{number} {'x' * 1000}")
    sizes = [path.stat().st_size for path in tmp_path.iterdir()]
    assert len(sizes) == journal.OLD_FILES + 1
    assert max(sizes) <= journal.FILE_BYTES + 2000
    assert " 1999 " in (tmp_path / journal.NAME).read_text("utf-8").splitlines()[-1]


def test_a_journal_that_cannot_be_written_is_in_nobodys_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("CHONA_LOGS", str(tmp_path / "file" / "logs"))
    journal.note("nothing")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("cannot read /home/anna/films/x.exr now", "cannot read x.exr now"),
        ("cannot read '/home/anna/secret film/x.exr' now", "cannot read 'x.exr' now"),
        ('File "/home/anna/lib/a.py", line 3', 'File "a.py", line 3'),
        (r"no C:\\Users\\anna\\x.blend; choose", "no x.blend; choose"),
        ("--out=/srv/anna/out --frames 1-2", "--out=out --frames 1-2"),
        ("30 rays/s of 1/2", "30 rays/s of 1/2"),
    ],
)
def test_paths_are_cut_to_names(text: str, told: str) -> None:
    found = without_secrets(text)
    assert found.startswith(told) and "anna" not in found


@pytest.mark.skipif(sys.platform == "win32", reason="its home folder is named otherwise")
def test_the_bundle_tells_what_is_needed_and_no_secrets(tmp_path: Path) -> None:
    home = tmp_path / "anna-secret"
    run = home / "films of anna" / "run"
    run.mkdir(parents=True)
    variables = environment(HOME=str(home), CHONA_LOGS=str(home / "logs"), USER="anna", LOGNAME="anna",
                            CHONA_PRESETS=str(home / "presets"))  # fmt: skip
    capture = write_capture(run / "capture")
    shot = write_tiny_shot(run / "walk.shot.npz", capture)
    model = write_header(run / "model.safetensors", training={"steps": 7, "poses_seen": [[0.123456]], "data": "a film"})
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(run / "preview.png")
    (run / "log.jsonl").write_text('{"step": 1, "seconds": 0.1, "loss": 2.5}\n', "utf-8")
    chona = [sys.executable, "-m", "chona_model"]
    words = ["bake", "--model", model, "--shot", shot, "--out", run / "frames", "--progress", "json"]
    failed = subprocess.run([*chona, *words], env=variables, capture_output=True, text=True, check=False)
    assert failed.returncode != 0, "the model has no tensors"
    bundle = tmp_path / "report.zip"
    done = subprocess.run(
        [*chona, "doctor", "--bundle", bundle, "--about", run, "--about", shot], env=variables, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(bundle) as archive:
        texts = {name: archive.read(name).decode("utf-8") for name in archive.namelist()}
    assert texts.keys() == {
        "doctor.txt", "machine.json", "packages.txt", "logs/chona.log", "01-run/files.txt", "01-run/log.jsonl.txt",
        "01-run/model.safetensors.header.json", "01-run/walk.shot.npz.header.json",
        "02-walk.shot.npz/walk.shot.npz.header.json",
    }  # fmt: skip
    everything = "\n".join([*texts, *texts.values()])
    for secret in ("anna", "films", str(tmp_path), "0.123456", rf"\b{re.escape(os.uname().nodename)}\b"):
        assert not re.search(secret, everything), secret
    assert "numpy" in texts["packages.txt"] and "torch" in texts["doctor.txt"]
    assert "Traceback" in texts["logs/chona.log"] and "--shot 'walk.shot.npz'" in texts["logs/chona.log"]
    assert '"loss": 2.5' in texts["01-run/log.jsonl.txt"] and "preview.png" in texts["01-run/files.txt"]
    header = json.loads(texts["01-run/model.safetensors.header.json"])
    assert header["chona"]["training"] == {"steps": 7, "data": "a film"}
    assert json.loads(texts["02-walk.shot.npz/walk.shot.npz.header.json"])["size"] == [32, 24]
