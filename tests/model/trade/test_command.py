"""``chona trade`` and ``chona estimate`` as a user runs them."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from cli_files import write_capture, write_tiny_shot
from PIL import Image
from test_cli import chona, events_of, refused

from chona_model.formats.model_file import read_header
from chona_model.settings import PRESETS

MODEL, SHOT = "run/model.safetensors", "walk.shot.npz"


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture, a shot and a model, measured with something asked for; frames baked before it was."""
    folder = tmp_path_factory.mktemp("trade")
    write_capture(folder / "capture")
    write_tiny_shot(folder / SHOT, folder / "capture")
    done = chona("train", "--data", "capture", "--out", "run", "--steps", "32", cwd=folder)
    assert done.returncode == 0, done.stderr
    shutil.copy(folder / MODEL, folder / "unmeasured.safetensors")
    done = chona("bake", "--model", MODEL, "--shot", SHOT, "--out", "frames", "--preset", "draft", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def measured(work: Path) -> dict:
    done = chona(
        "trade", "--model", MODEL, "--data", "capture", "--out", "trade", "--minutes", "0.05", "--seconds-per-frame",
        "10", "--save-preset", "mine", "--progress", "json", cwd=work, CHONA_PRESETS=str(work / "presets"),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    start, *between, end = events_of(done.stdout)
    assert (start["event"], start["job"], start["total"]) == ("start", "trade", 3.0)
    assert between and (end["event"], end["json"]) == ("result", str(Path("trade/trade.json")))
    return json.loads((work / "trade" / "trade.json").read_text())


def test_what_is_written(work: Path, measured: dict) -> None:
    assert list(measured["presets"]) == list(PRESETS)
    for row in [*measured["presets"].values(), *measured["knobs"], *measured["combined"]]:
        assert row["seconds"] > 0 and row["views"] >= 1 and 0 <= row["error"] < 1 and row["psnr"] > 5
        assert 0 <= row["failed_share"] <= 1 and row["error_alpha"] < 1
    exact = measured["presets"]["exact"]
    assert (exact["error"], exact["error_alpha"]) == (0.0, 0.0)
    assert measured["presets"]["draft"]["error"] > 0
    names = {row["knob"] for row in measured["knobs"]}
    assert {"step", "stop", "newton_steps", "tolerance", "starts", "supersampling", "occupancy"} < names
    seconds = [row["seconds"] for row in measured["front"]]
    assert seconds == sorted(seconds)
    assert measured["chosen"]["error"] == min(
        row["error"] for row in [*measured["presets"].values(), *measured["knobs"], *measured["combined"]]
        if row["seconds"] <= 10
    )  # fmt: skip
    with Image.open(work / "trade" / "trade.png") as image:
        image.load()
        assert image.width > 800 and image.getextrema()[0][0] < 64, "an empty plot"


def test_the_result_travels_in_the_model_and_frames_stay_valid(work: Path, measured: dict) -> None:
    trade = read_header(work / MODEL).trade
    assert trade is not None
    for name in PRESETS:
        assert trade["presets"][name]["psnr"] == measured["presets"][name]["psnr"]
    assert (trade["size"], trade["reference"]["person"]) == ([32, 24], "Sub01")
    again = chona("bake", "--model", MODEL, "--shot", SHOT, "--out", "frames", "--preset", "draft", cwd=work)
    assert again.stdout.startswith("0 frames written, 3 were up to date")
    told = chona("info", MODEL, cwd=work).stdout
    assert f"{measured['presets']['final']['psnr']:.1f} dB" in told


def test_what_was_found_is_a_preset(work: Path, measured: dict, tmp_path: Path) -> None:
    saved = json.loads((work / "presets" / "mine.json").read_text())
    assert saved["settings"] == measured["chosen"]["settings"] | {"preset": "mine"}
    arguments = ("bake", "--model", MODEL, "--shot", SHOT, "--out", str(tmp_path), "--preset", "mine", "--frames", "0")
    done = chona(*arguments, cwd=work, CHONA_PRESETS=str(work / "presets"))
    assert done.returncode == 0, done.stderr
    refused(chona(*arguments, cwd=work, CHONA_PRESETS=str(tmp_path)), ["no preset 'mine'", "draft, preview, final"])


def test_estimates(work: Path, measured: dict) -> None:
    done = chona(
        "estimate", "--model", MODEL, "--shot", SHOT, "--preset", "draft", "--seconds", "0.3", "--progress", "json",
        cwd=work,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    end = events_of(done.stdout)[-1]
    assert (end["event"], end["frames"]) == ("result", 3)
    assert end["factor"] > 0
    for name in PRESETS:
        each = end["presets"][name]
        assert each["psnr"] == measured["presets"][name]["psnr"]
        assert each["total_seconds"] == pytest.approx(end["start_seconds"] + 3 * each["seconds_per_frame"])
    assert end["presets"]["exact"]["seconds_per_frame"] > end["presets"]["draft"]["seconds_per_frame"]
    alone = chona("estimate", "--model", MODEL, "--seconds", "0.2", cwd=work)
    assert alone.returncode == 0 and "s a frame here; 1 frame ≈" in alone.stdout


def test_estimates_of_a_model_nobody_measured(work: Path) -> None:
    arguments = ("estimate", "--model", "unmeasured.safetensors", "--seconds", "0.2", "--frames", "0")
    refused(chona(*arguments, cwd=work), ["was not measured yet", "chona trade"])
    done = chona(*arguments, "--shot", SHOT, "--progress", "json", cwd=work)
    end = events_of(done.stdout)[-1]
    assert end["factor"] is None and end["frames"] == 1
    assert all(each["psnr"] is None and each["seconds_per_frame"] > 0 for each in end["presets"].values())


def test_what_cannot_be_reached_is_said_and_nothing_measured_is_lost(work: Path, tmp_path: Path) -> None:
    before = (work / "unmeasured.safetensors").read_bytes()
    arguments = ["--model", "unmeasured.safetensors", "--data", "capture", "--minutes", "0.02", "--no-save"]
    done = chona("trade", *arguments, "--out", tmp_path, "--psnr", "90", cwd=work)
    refused(done, ["no settings reach 90 dB", "the best measured have"])
    assert (tmp_path / "trade.json").is_file() and (tmp_path / "trade.png").is_file()
    assert (work / "unmeasured.safetensors").read_bytes() == before


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--save-preset", "mine"], ["nothing was asked for", "--seconds-per-frame"]),
        (["--save-preset", "final", "--psnr", "20"], ["comes with the program"]),
        (["--seconds-per-frame", "-1"], ["-1"]),
    ],
)
def test_what_makes_no_sense_is_refused_at_once(work: Path, tmp_path: Path, more: list[str], words: list[str]) -> None:
    done = chona(
        "trade", "--model", MODEL, "--data", "capture", "--out", tmp_path / "out", *more, cwd=work,
        CHONA_PRESETS=os.devnull + ".none",
    )  # fmt: skip
    refused(done, words)
    assert not (tmp_path / "out" / "trade.json").exists()
