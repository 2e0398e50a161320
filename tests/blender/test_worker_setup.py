"""Set Up Worker: from tiny wheels quickly, with everything that can go wrong; the real packages in a slow test."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from operation_helpers import ROOT, bpy_pythons, run_bpy
from wheels import write_worker_wheels

pytestmark = pytest.mark.bpy


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extension's zip."""
    command = [sys.executable, ROOT / "scripts" / "build_extension.py", "--out", tmp_path_factory.mktemp("zip")]
    return Path(subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip())


@pytest.fixture(scope="module")
def answer(package: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What happened in the first Blender; nothing of it depends on the version."""
    folder = tmp_path_factory.mktemp("setup")
    good = write_worker_wheels(folder / "good")
    lacking = write_worker_wheels(folder / "lacking", without="torch")
    environment = {"BLENDER_USER_RESOURCES": str(folder / "resources")}
    return run_bpy(bpy_pythons()[0], "operation_setup.py", package, good, lacking, environment=environment)


def test_nothing_is_downloaded_unasked(answer: dict) -> None:
    """Blender's online access is off in a new installation: a set-up says so, and what else there is."""
    assert answer["online"] is False
    offline = answer["offline"]
    assert offline["code"] == 2
    assert all(words in offline["words"] for words in ("online access is off", "--online-mode", "folder of wheels"))


def test_what_cannot_start_is_told_before(answer: dict) -> None:
    for case, words in (
        ("no folder", "there is no folder"),
        ("no ensurepip", "lacks ensurepip"),
        ("old", "is Python 3.9.1, expected 3.11 or newer"),
        ("no python", "does not start as a Python"),
    ):
        assert answer[case]["code"] == 2, case
        assert words in answer[case]["words"].splitlines()[-1].replace("There", "there"), answer[case]
        assert "Traceback" not in answer[case]["words"], case
    assert answer["before"] == "None"


def test_half_a_set_up_is_none(answer: dict) -> None:
    """Killed or cancelled while pip works: no process stays, nothing counts as set up, and the next one repairs."""
    for case, status in (("killed", "FAILED"), ("cancelled", "CANCELLED")):
        assert answer[case] == answer[case] | {"alive": [], "status": status, "python": "None"}, answer[case]
        assert answer[case]["seconds"] < 5.0
    assert answer["set up"]["code"] == 0, answer["set up"]


def test_a_set_up_environment_is_the_worker(answer: dict) -> None:
    folder = Path(answer["folder"])
    assert answer["python"].startswith(str(folder / "worker")) and ".user" in folder.parts
    assert answer["found"] == [answer["python"], "Set Up Worker"]
    assert answer["ready"]["torch"].endswith("+tiny") and answer["ready"]["device"] == "cpu"
    assert answer["ready"]["bytes"] > 10**6
    assert answer["left"] == ["worker", "worker.lock"]  # neither downloads nor the half-made
    assert answer["check"]["code"] == 0 and "torch: 2" in answer["check"]["out"]


def test_before_it_starts_it_says_what_comes(answer: dict) -> None:
    words = answer["set up"]["words"]
    pins = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line.startswith("torch==")]
    assert pins[0].replace("==", " ") in words and "without the network" in words and answer["folder"] in words
    assert "checking the environment" in words
    assert all("Installs torch" in lines[0] for lines in answer["needs"].values())


def test_cuda_without_cuda_is_told(answer: dict) -> None:
    """A choice of CUDA where torch or the driver has none is a fault; left to the add-on it is a note."""
    assert answer["for cuda"]["code"] == 2 and "the device is CUDA, which cannot be used" in answer["for cuda"]["out"]
    summary, *notes = answer["no card, cuda"]
    assert "the driver is too old" in summary and "Automatic" in summary
    summary, *notes = answer["no card, auto"]
    assert summary == "Python 3.11.7, torch 2.13.0, CPU only" and notes == ["CUDA: the driver is too old; update"]


def test_a_failed_set_up_leaves_the_one_before(answer: dict) -> None:
    assert answer["lacking"]["code"] == 1 and "no wheel of torch==" in answer["lacking"]["words"]
    assert answer["still"] is True
    assert "online access is off" in answer["operator without wheels"]


def test_wrong_packages_are_named(answer: dict) -> None:
    assert "torch in the worker's Python /python is 2.5.1; expected 2.6 or newer" in answer["old torch"]
    assert answer["newer is fine"] == ""
    assert "loads chona_model from /elsewhere/chona_model" in answer["foreign"]


def test_removal_frees_the_space(answer: dict) -> None:
    assert "which is gone" in answer["base gone"] and "Set Up Worker" in answer["base gone"]
    assert answer["removed"] == [True, 0, "None"]
    assert answer["remove"]["code"] == answer["remove again"]["code"] == 0
    assert "MB are free again" in answer["remove"]["words"] and "0 MB" in answer["remove again"]["words"]


def test_sizes_were_measured_with_these_pins() -> None:
    """A changed pin needs `python scripts/measure_worker.py`: the dialog must not promise old sizes."""
    table = json.loads((ROOT / "chona_blender" / "worker_sizes.json").read_text())
    pins = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line)
    pins = {name.lower().replace("_", "-"): version for name, version in pins.items()}
    for system, devices in table["systems"].items():
        for device, entry in devices.items():
            assert entry["installed"] > sum(entry["wheels"].values()) > 10**8
            assert "torch" in entry["wheels"]
            wrong = [name for name, version in entry["versions"].items() if pins.get(name, version) != version]
            assert not wrong, (system, device, wrong)


@pytest.mark.slow
def test_the_real_packages(package: Path, tmp_path: Path) -> None:
    """From pip's configured index, as a user: set up, checked, and the kernels' self-test passes in it."""
    environment = {"BLENDER_USER_RESOURCES": str(tmp_path)}
    answer = run_bpy(
        bpy_pythons()[0], "operation_setup_real.py", package, environment=environment, seconds=1800.0
    )  # fmt: skip
    assert answer["code"] == 0, answer["words"]
    assert "CPU" in answer["words"] and answer["doctor"]["ok"] is True
