"""The worker of a training is killed: the list says what happened and what to do, and Resume gives the same model."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from operation_helpers import ROOT, bpy_pythons, needs_worker, run_bpy

pytestmark = [pytest.mark.bpy, pytest.mark.skipif(sys.platform == "win32", reason="kills a process")]


def tensors_of(model: Path) -> bytes:
    """A model file without its header, which holds the seconds."""
    content = model.read_bytes()
    return content[8 + int.from_bytes(content[:8], "little") :]


@pytest.mark.parametrize("python", bpy_pythons()[:1])
def test_a_killed_training_is_told_and_resumed(python: str, tmp_path: Path) -> None:
    needs_worker(python)
    from cli_files import write_capture

    small = ROOT / "tests" / "model" / "train" / "tiny_runs.py"
    answer = run_bpy(
        python,
        "steady_training.py",
        sys.executable,
        write_capture(tmp_path / "capture"),
        tmp_path,
        small,
        steady=True,
        seconds=550,
    )
    result, status, told, rows = answer["killed"]
    assert (result, status) == (["CANCELLED"], "FAILED")
    assert told.startswith("The worker was ended by signal 9")
    assert told.endswith("; its last checkpoint is there: press Resume to go on from it")
    assert [row[:2] for row in rows] == [["one", "FAILED"], ["two", "WAITING"]]
    assert rows[0][2][1:] == told[1:]
    assert answer["left"] == [[], [], True] and answer["resume"]
    assert answer["resumed"] == [["FINISHED"]] * 2
    assert answer["told when it runs again"] == ["", ""]
    assert [row[:2] for row in answer["rows"]] == [["one", "DONE"], ["two", "DONE"]]
    killed, whole = (tensors_of(tmp_path / name / "model.safetensors") for name in ("one", "two"))
    assert killed == whole
