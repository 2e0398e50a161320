"""Real processes through the add-on's worker and jobs: protocol, errors, cancel, and the check of a Python."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from operation_helpers import ROOT, bpy_pythons, run_bpy, write_header_only_model

pytestmark = pytest.mark.bpy


@pytest.fixture(scope="module", params=bpy_pythons())
def answer(request: pytest.FixtureRequest) -> dict:
    """What happened in one version of Blender; this Python is the worker's, the one with bpy has no torch."""
    pytest.importorskip("torch")
    return run_bpy(request.param, "operation_worker.py", sys.executable, request.param)


def test_environment_is_the_workers_own(answer: dict) -> None:
    assert answer["sources"] == str(ROOT)
    expected = {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1", "PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "utf-8"}
    assert answer["environment"] == expected


def test_progress_and_result(answer: dict) -> None:
    done = answer["steps"]
    assert (done["status"], done["code"], done["share"]) == ("DONE", 0, 1.0)
    assert done["result"]["written"] == 5
    assert "5 of 5" in done["text"] and "loss 0.25" in done["text"]


def test_what_is_not_protocol_is_kept_as_words(answer: dict) -> None:
    noise = answer["noise"]
    assert noise["status"] == "DONE" and noise["result"]["written"] == 1
    assert {"a library says hello", "{not json}", "[1, 2]", "a warning"} <= set(noise["lines"])


def test_failures_are_told_in_words(answer: dict) -> None:
    wrong, crash, killed = answer["wrong input"], answer["crash"], answer["killed"]
    assert (wrong["status"], wrong["code"]) == ("FAILED", 2)
    assert wrong["error"].startswith("model.safetensors: expected version 1")
    assert (crash["status"], crash["code"]) == ("FAILED", 1)
    assert "ValueError: the reason" in crash["error"]
    assert killed["status"] == "FAILED" and "signal 9" in killed["error"] and "memory" in killed["error"]


def test_cancel_ends_the_process(answer: dict) -> None:
    for case in ("cancelled", "deaf"):
        assert answer[case]["status"] == "CANCELLED", case
        assert answer[case]["seconds"] < 3.0, case
        assert not answer[case]["alive"], case


def test_nothing_outlives_blender(answer: dict) -> None:
    """A farm's SIGTERM and switching the add-on off both end the worker."""
    assert answer["farm"]["status"] == "CANCELLED" and not answer["farm"]["alive"]
    assert answer["closed"]["gone"]


def test_check_says_what_is_wrong(answer: dict) -> None:
    assert "torch" in answer["check good"] and "no torch" not in answer["check good"]
    assert "has no torch" in answer["check bare"]
    assert "-m pip install torch" in answer["check bare"]
    assert answer["check quick"] is False
    assert "does not start" in answer["not there"]
    assert "does not exist" in answer["wrong variable"] and "CHONA_WORKER_PYTHON" in answer["wrong variable"]


def test_the_named_python_is_taken(answer: dict) -> None:
    assert answer["found"] == sys.executable
    assert answer["variable"][0] == sys.executable


@pytest.mark.parametrize("python", bpy_pythons())
def test_the_real_worker_refuses_a_model_without_tensors(python: str, tmp_path: Path) -> None:
    """Add-on, shot, `chona bake` and back: the worker's own words and exit code arrive."""
    if importlib.util.find_spec("chona_model.__main__") is None:
        pytest.skip("chona_model has no command line yet")
    model = write_header_only_model(tmp_path / "model.safetensors")
    answer = run_bpy(python, "operation_chona.py", model, sys.executable, tmp_path / "out")
    assert answer["code"] == 2, answer
    assert "Traceback" not in answer["words"], answer
    assert "model.safetensors" in answer["words"] or "tensor" in answer["words"], answer
    assert (tmp_path / "out" / "shot.shot.npz").is_file()
