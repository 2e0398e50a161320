"""The command line as a process: what it prints, what it leaves, and how it ends."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
from cli_files import SEQUENCE, write_capture, write_header, write_tiny_shot

import chona_model

SECONDS = 240


def chona(*arguments: str | Path, cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Runs ``python -m chona_model`` to its end."""
    return subprocess.run(
        [sys.executable, "-m", "chona_model", *map(str, arguments)], cwd=cwd, env={**os.environ, **variables},
        capture_output=True, text=True, timeout=SECONDS, check=False,
    )  # fmt: skip


def events_of(text: str) -> list[dict]:
    """JSON lines, and nothing else among them."""
    return [json.loads(line) for line in text.splitlines()]


def refused(result: subprocess.CompletedProcess[str], words: Sequence[str]) -> None:
    """Exit code 2 and one line on stderr that holds ``words``."""
    lines = result.stderr.splitlines()
    assert result.returncode == 2, result.stderr
    assert len(lines) == 1 and lines[0].startswith("chona: "), lines
    assert all(word in lines[0] for word in words), lines[0]


@pytest.fixture(scope="session")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture, a shot, a model trained for three steps, and a model file of a header alone."""
    folder = tmp_path_factory.mktemp("work")
    write_capture(folder / "capture")
    write_tiny_shot(folder / "walk.shot.npz", folder / "capture")
    write_header(folder / "header.safetensors")
    done = chona("train", "--data", "capture", "--out", "run", "--steps", "3", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


# What every command shares


def test_help_and_info_start_without_torch(work: Path) -> None:
    for words in (["--help"], ["train", "--help"], ["info", "header.safetensors"], ["bake", "--nonsense"]):
        code = (
            "import sys, chona_model.cli as cli\n"
            f"cli.main({words!r})\n"
            "heavy = {'torch', 'numba', 'scipy', 'PIL', 'skimage', 'OpenEXR'} & set(sys.modules)\n"
            "sys.exit(f'loaded {heavy}' if heavy else 0)"
        )
        done = subprocess.run([sys.executable, "-c", code], cwd=work, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def test_help_names_every_command(tmp_path: Path) -> None:
    done = chona("--help", cwd=tmp_path)
    assert done.returncode == 0
    for name in ("train", "evaluate", "bake", "info", "check-data", "doctor", "demo"):
        assert name in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["COMMAND"]),
        (["paint"], ["paint", "train", "bake"]),
        (["bake"], ["--model", "--shot", "--out", "chona bake --help"]),
        (["bake", "--model", "m", "--shot", "s", "--out", "o", "--preset", "best"], ["best", "draft", "exact"]),
        (["bake", "--model", "m", "--shot", "s", "--out", "o", "--frames", "9-3"], ["9-3", "empty", "3-9"]),
        (["bake", "--model", "m", "--shot", "s", "--out", "o", "--frames", "1-x"], ["1-x", "1-50,60"]),
        (["bake", "--model", "m", "--shot", "s", "--out", "o", "--frames", ""], ["1-50,60"]),
        (["bake", "--model", "m", "--shot", "s", "--out", "o", "--fram", "1"], ["--fram"]),
        (["train", "--out", "o"], ["--data"]),
        (["train", "--data", "d", "--out", "o", "--minutes", "1", "--steps", "2"], ["--minutes", "--steps"]),
        (["train", "--data", "d", "--out", "o", "--minutes", "0"], ["--minutes", "above 0"]),
        (["train", "--data", "d", "--out", "o", "--minutes", "nan"], ["--minutes", "nan"]),
        (["train", "--data", "d", "--out", "o", "--steps", "1.5"], ["--steps", "1.5", "whole"]),
        (["train", "--data", "d", "--out", "o", "--image-scale", "2"], ["--image-scale", "at most 1"]),
        (["train", "--data", "d", "--out", "o", "--seed", "-1"], ["--seed", "-1"]),
        (["train", "--data", "d", "--out", "o", "--method", "magic"], ["magic", "chona", "no-cil"]),
        (["train", "--data", "d", "--out", "o", "--preset", "final"], ["final", "fast", "paper"]),
        (["train", "--data", "d", "--sequences", ",", "--out", "o"], ["--sequences", "empty"]),
        (["train", "--data", "d", "--sequences", "a", "--split", "f:k", "--out", "o"], ["--sequences", "--split"]),
        (["train", "--data", "d", "--format", "auto", "--format", "auto", "--out", "o"], ["--format", "twice"]),
        (["train", "--data", "nowhere", "--out", "o"], ["nowhere"]),
        (["add", "--model", "m", "--data", "d", "--out", "o"], ["--identity", "chona add --help"]),
        (["info", "nowhere.safetensors"], ["nowhere.safetensors", "chona train"]),
        (["check-data", "nowhere"], ["nowhere"]),
    ],
)  # fmt: skip
def test_bad_arguments_are_one_line_and_two(tmp_path: Path, arguments: list[str], words: list[str]) -> None:
    done = chona(*arguments, cwd=tmp_path)
    refused(done, words)
    assert done.stdout == ""


def test_bad_arguments_are_an_event_too(tmp_path: Path) -> None:
    for option in (["--progress", "json"], ["--progress=json"]):
        done = chona("bake", *option, cwd=tmp_path)
        (event,) = events_of(done.stdout)
        assert event["event"] == "error" and event["job"] == "bake" and event["code"] == 2
        assert done.stderr == f"chona: {event['message']}\n"
        refused(done, ["--model"])


def test_an_unforeseen_error_is_one_line_and_one(tmp_path: Path) -> None:
    code = (
        "import sys, chona_model.info, chona_model.cli as cli\n"
        "def fails(path): raise ValueError('a bug\\nin two lines')\n"
        "chona_model.info.describe = fails\n"
        "sys.exit(cli.main(['info', 'x', *sys.argv[1:]]))"
    )
    plain, debug = (
        subprocess.run([sys.executable, "-c", code, *more], cwd=tmp_path, capture_output=True, text=True, check=False)
        for more in ([], ["--debug"])
    )
    assert plain.returncode == debug.returncode == 1
    assert plain.stderr == "chona: ValueError: a bug in two lines (--debug shows where)\n"
    assert "Traceback" in debug.stderr and debug.stderr.endswith("chona: ValueError: a bug in two lines\n")


@pytest.mark.skipif(torch.cuda.is_available(), reason="this computer has CUDA")
@pytest.mark.parametrize("command", ["train", "evaluate", "bake"])
def test_cuda_that_is_not_there(work: Path, tmp_path: Path, command: str) -> None:
    arguments: dict[str, list[str | Path]] = {
        "train": ["--data", "capture", "--out", tmp_path / "run"],
        "evaluate": ["--model", "run/model.safetensors", "--data", "capture", "--json", tmp_path / "e.json"],
        "bake": ["--model", "run/model.safetensors", "--shot", "walk.shot.npz", "--out", tmp_path / "frames"],
    }
    refused(chona(command, *arguments[command], "--device", "cuda", cwd=work), ["cuda", "--device cpu"])


def test_the_demo_is_named_where_it_is_absent(tmp_path: Path) -> None:
    package = Path(chona_model.__file__).parent
    shutil.copytree(package, tmp_path / "chona_model", ignore=shutil.ignore_patterns("__pycache__"))
    done = chona("demo", "--out", "shown", cwd=tmp_path, PYTHONPATH=str(tmp_path))
    refused(done, ["demo", "repository"])
    assert not (tmp_path / "shown").exists()


# Model files


def test_info(work: Path) -> None:
    done = chona("info", "run/model.safetensors", cwd=work)
    assert done.returncode == 0 and done.stderr == ""
    for word in ("Sub01", "box01", "hips", "chona", "sha256", "capture"):
        assert word in done.stdout
    told = json.loads(chona("info", "run/model.safetensors", "--json", cwd=work).stdout)
    assert told["persons"].keys() == {"Sub01"} and told["objects"].keys() == {"box01"}
    assert told["skeleton"] == {"names": ["hips", "chest", "head"], "parents": [-1, 0, 1]}
    assert told["training"]["steps"] == 3 and SEQUENCE in told["training"]["data"]
    assert told["bytes"] == (work / "run" / "model.safetensors").stat().st_size and len(told["sha256"]) == 64


@pytest.mark.parametrize("command", ["info", "bake", "evaluate"])
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda path: write_header(path, version=9), ["version 9", "version 1"]),
        (lambda path: write_header(path, format="other"), ["other", "chona-model"]),
        (lambda path: path.write_bytes(b"PK"), ["2 bytes", "chona train"]),
        (lambda path: path.write_bytes(b"\xff" * 64), ["64 bytes"]),
        (lambda path: path.mkdir(), ["model.safetensors"]),
        (lambda path: None, ["there is no model file"]),
    ],
    ids=["version", "format", "short", "noise", "folder", "absent"],
)
def test_unusable_models(work: Path, tmp_path: Path, command: str, spoil, words: list[str]) -> None:
    path = tmp_path / "model.safetensors"
    spoil(path)
    arguments: dict[str, list[str | Path]] = {
        "info": [path],
        "bake": ["--model", path, "--shot", work / "walk.shot.npz", "--out", tmp_path / "frames"],
        "evaluate": ["--model", path, "--data", work / "capture", "--json", tmp_path / "e.json"],
    }
    refused(chona(command, *arguments[command], cwd=tmp_path), words)


def test_a_cut_off_model(work: Path, tmp_path: Path) -> None:
    whole = (work / "run" / "model.safetensors").read_bytes()
    (tmp_path / "model.safetensors").write_bytes(whole[: len(whole) // 2])
    refused(chona("info", "model.safetensors", cwd=tmp_path), ["cut off", str(len(whole))])


# Baking


def bake(work: Path, out: Path, *more: str | Path) -> subprocess.CompletedProcess[str]:
    return chona(
        "bake", "--model", "run/model.safetensors", "--shot", "walk.shot.npz", "--out", out, "--preset", "draft", *more,
        cwd=work,
    )  # fmt: skip


def test_bake_reports_frames_and_skips_finished_ones(work: Path, tmp_path: Path) -> None:
    done = bake(work, tmp_path, "--frames", "-1-0", "--progress", "json")
    assert done.returncode == 0, done.stderr
    start, *between, end = events_of(done.stdout)
    assert (start["event"], start["job"], start["total"]) == ("start", "bake", 2)
    assert between[-1]["event"] == "progress" and between[-1]["done"] == between[-1]["total"] == 2
    assert between[-1]["message"] == "walk_0000.exr"
    assert (end["event"], end["written"], end["skipped"]) == ("result", 2, 0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["walk_-0001.exr", "walk_0000.exr"]
    again = bake(work, tmp_path, "--progress", "json")
    assert events_of(again.stdout)[-1] | {"seconds": 0} == end | {"written": 1, "skipped": 2, "seconds": 0}
    terminal = bake(work, tmp_path)
    assert terminal.returncode == 0 and terminal.stderr == ""
    assert terminal.stdout.startswith("0 frames written, 3 were up to date")


def test_frames_outside_the_shot(work: Path, tmp_path: Path) -> None:
    refused(bake(work, tmp_path, "--frames", "-5--2"), ["-5", "-1 to 1"])


def test_a_shot_of_an_unknown_person(work: Path, tmp_path: Path) -> None:
    shot = write_tiny_shot(tmp_path / "other.shot.npz", work / "capture", person="Robin")
    arguments = ["--model", work / "run" / "model.safetensors", "--shot", shot, "--out", tmp_path / "frames"]
    refused(chona("bake", *arguments, cwd=work), ["Robin", "Sub01"])


@pytest.mark.parametrize("content", [None, b"", b"no archive"], ids=["absent", "empty", "noise"])
def test_unusable_shots(work: Path, tmp_path: Path, content: bytes | None) -> None:
    shot = tmp_path / "bad.shot.npz"
    if content is not None:
        shot.write_bytes(content)
    arguments = ["--model", work / "run" / "model.safetensors", "--shot", shot, "--out", tmp_path / "frames"]
    refused(chona("bake", *arguments, cwd=work), ["bad.shot.npz"])


# Rights cannot be tried as root, who ignores them; a file in the way stops everybody.
@pytest.mark.parametrize("below", [False, True], ids=["the folder", "above the folder"])
def test_a_file_in_the_way_of_the_output(work: Path, tmp_path: Path, below: bool) -> None:
    file = tmp_path / "taken"
    file.write_text("x", "utf-8")
    out = file / "frames" if below else file
    refused(bake(work, out), ["--out", str(out), "file"])
    refused(chona("train", "--data", "capture", "--out", out, "--steps", "1", cwd=work), ["--out", str(out), "file"])
    assert file.read_text("utf-8") == "x"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root ignores rights")
def test_a_folder_without_the_right_to_write(work: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        refused(bake(work, tmp_path), ["--out", str(tmp_path), "rights"])
    finally:
        tmp_path.chmod(0o700)


# Captures


def test_check_data(work: Path, tmp_path: Path) -> None:
    done = chona("check-data", "capture", "--out", tmp_path / "seen", "--json", tmp_path / "r.json", cwd=work)
    assert done.returncode == 0, done.stderr
    assert "Sub01" in done.stdout and SEQUENCE in done.stdout and (tmp_path / "seen" / f"{SEQUENCE}.png").is_file()
    report = json.loads((tmp_path / "r.json").read_text("utf-8"))
    assert report["views"] == 4 and report["sequences"][0]["joints_inside"] > 0.9


def test_a_truncated_image(work: Path, tmp_path: Path) -> None:
    shutil.copytree(work / "capture", tmp_path / "capture")
    image = tmp_path / "capture" / "sequences" / SEQUENCE / "0002" / "k1.color.png"
    image.write_bytes(image.read_bytes()[:-200])
    refused(chona("train", "--data", "capture", "--out", "run", "--steps", "1", cwd=tmp_path), [str(image.name)])
    checked = chona("check-data", "capture", cwd=tmp_path)
    assert checked.returncode == 1 and "k1.color.png" in checked.stdout


def test_an_unknown_sequence(work: Path, tmp_path: Path) -> None:
    done = chona("train", "--data", "capture", "--sequences", "dance", "--out", tmp_path, cwd=work)
    refused(done, ["dance", SEQUENCE])


def test_a_split_without_the_key(work: Path, tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text(json.dumps({"train": [SEQUENCE]}), "utf-8")
    done = chona("train", "--data", "capture", "--split", f"{tmp_path}/s.json:test", "--out", tmp_path, cwd=work)
    refused(done, ["test", "train"])


@pytest.mark.parametrize(
    ("format", "words"), [("zju_mocap", ["CoreView_386", "annots.npy"]), ("video", ["video", "auto", "zju_mocap"])]
)
def test_formats_that_the_capture_has_not(work: Path, tmp_path: Path, format: str, words: list[str]) -> None:
    done = chona("train", "--data", "capture", "--format", format, "--out", tmp_path, cwd=work)
    refused(done, words)


def test_behave_without_calibration(hoibench: Path, tmp_path: Path) -> None:
    sequence = next(iter(sorted((hoibench / "behave" / "sequences").iterdir())))
    frame = next(iter(sorted(path for path in sequence.iterdir() if path.is_dir())))
    copy = tmp_path / "behave" / "sequences" / sequence.name
    shutil.copytree(frame, copy / frame.name)
    shutil.copy(sequence / "info.json", copy)
    (tmp_path / "behave" / "objects").symlink_to(hoibench / "behave" / "objects")
    done = chona("check-data", "behave", "--body-model", hoibench / "smplh", cwd=tmp_path)
    refused(done, ["calib"])


def test_several_captures_are_joined_in_order(work: Path, tmp_path: Path) -> None:
    done = chona(
        "train", "--data", "capture", "--format", "blender", "--sequences", SEQUENCE, "--data", "capture",
        "--sequences", f"{SEQUENCE}/0001", "--out", tmp_path, cwd=work,
    )  # fmt: skip
    refused(done, [f"{SEQUENCE}_0001_k0", "two"])
    apart = [
        "--data",
        "capture",
        "--sequences",
        f"{SEQUENCE}/0001",
        "--data",
        "capture",
        "--sequences",
        f"{SEQUENCE}/0002",
    ]
    done = chona("train", *apart, "--out", tmp_path, "--steps", "1", cwd=work)
    assert done.returncode == 0, done.stderr
    assert (
        json.loads(chona("info", tmp_path / "model.safetensors", "--json", cwd=work).stdout)["training"]["views"] == 4
    )


# Training and measuring


def test_train_reports_in_json(work: Path, tmp_path: Path) -> None:
    done = chona("train", "--data", "capture", "--out", tmp_path, "--steps", "2", "--progress", "json", cwd=work)
    assert done.returncode == 0, done.stderr
    start, *between, end = events_of(done.stdout)
    assert (start["event"], start["job"], start["total"]) == ("start", "train", 2)
    assert all({"done", "total", "seconds", "eta", "loss", "psnr"} <= event.keys() for event in between) and between
    assert end["event"] == "result" and Path(end["model"]) == tmp_path / "model.safetensors"


@pytest.mark.parametrize(
    ("identity", "words"),
    [
        ("Sub01=", ["'Sub01='", "NAME or NAME=NEW"]),
        ("Sub01=A,box01=A", ["'box01=A'", "two by one name"]),
        ("Sub01", ["holds 'Sub01' already", "--identity Sub01=NEW"]),
        ("Sub09=A", ["no 'Sub09' in the data", "Sub01, box01"]),
        ("Sub01=A", ["no view shows 'Sub01' without box01"]),
    ],
)
def test_what_cannot_be_added(work: Path, tmp_path: Path, identity: str, words: list[str]) -> None:
    model, capture = work / "run" / "model.safetensors", work / "capture"
    given = ["--model", str(model), "--data", str(capture), "--identity", identity, "--out", str(tmp_path / "out")]
    refused(chona("add", *given, cwd=tmp_path), words)
    assert not (tmp_path / "out" / "model.safetensors").exists()


def test_a_person_and_an_object_are_added(work: Path, tmp_path: Path) -> None:
    model, capture = work / "run" / "model.safetensors", work / "capture"
    given = ["--model", str(model), "--data", str(capture), "--identity", "Sub01=Ann,box01=Crate", "--steps", "2"]
    done = chona("add", *given, "--out", str(tmp_path), "--progress", "json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert events_of(done.stdout)[-1]["model"] == str(tmp_path / "model.safetensors")
    told = chona("info", str(tmp_path / "model.safetensors"), "--json", cwd=tmp_path)
    assert {"Ann", "Crate", "Sub01", "box01"} <= {
        *json.loads(told.stdout)["persons"],
        *json.loads(told.stdout)["objects"],
    }


def test_evaluate(work: Path, tmp_path: Path) -> None:
    done = chona(
        "evaluate", "--model", "run/model.safetensors", "--data", "capture", "--preset", "draft", "--save-images",
        tmp_path / "images", "--json", tmp_path / "e.json", cwd=work,
    )  # fmt: skip
    assert done.returncode == 0 and done.stderr == "", done.stderr
    report = json.loads((tmp_path / "e.json").read_text("utf-8"))
    mean = {"psnr", "ssim", "psnr_box", "ssim_box", "seconds", "rays_per_second", "failed_share"}
    assert report.keys() == {"mean", "images", "settings", "model", "machine"} and report["mean"].keys() == mean
    assert len(report["images"]) == 4 and mean | {"sequence", "frame", "camera"} <= report["images"][0].keys()
    assert len(list((tmp_path / "images").glob("*.png"))) == 8


def test_a_folder_in_the_way_of_the_json(work: Path, tmp_path: Path) -> None:
    arguments = ["--model", "run/model.safetensors", "--data", "capture", "--json", tmp_path]
    refused(chona("evaluate", *arguments, cwd=work), ["--json", "folder"])


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals there")
@pytest.mark.slow  # in CI: tests/faults/test_processes.py
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_training_with_its_model_written(work: Path, tmp_path: Path, number: int) -> None:
    command = ["train", "--data", "capture", "--out", str(tmp_path), "--steps", "1000000", "--progress", "json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "chona_model", *command],
        cwd=work,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        while json.loads(process.stdout.readline())["event"] != "progress":
            pass
        process.send_signal(number)
        started = time.monotonic()
        output, errors = process.communicate(timeout=SECONDS)
    finally:
        process.kill()
    assert process.returncode == 1 and errors == ""
    last = events_of(output)[-1]
    assert (last["event"], last["job"]) == ("cancelled", "train")
    assert time.monotonic() - started < 30
    assert chona("info", tmp_path / "model.safetensors", cwd=work).returncode == 0
    resumed = chona("train", "--data", "capture", "--out", tmp_path, "--steps", "1", "--resume", cwd=work)
    assert resumed.returncode == 0, resumed.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals there")
def test_a_signal_before_the_first_step(work: Path, tmp_path: Path) -> None:
    code = (
        "import os, signal, sys, chona_model.data.opener as opener, chona_model.cli as cli\n"
        "opened = opener.open_dataset\n"
        "def interrupted(*a, **k):\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "    return opened(*a, **k)\n"
        "opener.open_dataset = interrupted\n"
        f"sys.exit(cli.main(['train', '--data', 'capture', '--out', {str(tmp_path)!r}, '--progress', 'json']))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=work, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stderr == ""
    assert events_of(done.stdout) == [{"event": "cancelled", "job": "train"}]


def test_a_reader_that_goes_away_is_no_traceback(work: Path, tmp_path: Path) -> None:
    command = ["train", "--data", "capture", "--out", str(tmp_path), "--steps", "1000000", "--progress", "json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "chona_model", *command],
        cwd=work,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.wait(timeout=SECONDS) == 1
        assert "Traceback" not in process.stderr.read()
    finally:
        process.kill()
        process.stderr.close()


@pytest.mark.slow
def test_a_bake_within_a_bound_says_what_it_reached(work: Path, tmp_path: Path) -> None:
    bounded = ("--frames", "0", "--max-error", "0.1")
    done = bake(work, tmp_path, *bounded, "--progress", "json")
    assert done.returncode == 0, done.stderr
    reached = events_of(done.stdout)[-1]["max_error"]
    assert reached["asked"] == 0.1 and reached["pixels"] > 0
    assert (reached["error"] <= 0.1) == (reached["unsettled"] == 0)
    assert bake(work, tmp_path, *bounded).stdout.startswith("0 frames written, 1 were up to date")
    plain = bake(work, tmp_path, "--frames", "0")
    assert plain.stdout.startswith("1 frames written"), "a frame with another bound was taken for this one"
    assert "refined" in bake(work, tmp_path, *bounded).stdout
    refused(bake(work, tmp_path, "--max-error", "2"), ["--max-error", "'2'", "at most 0.5"])
