"""Nothing opens a connection, no command and no button, but the button that says so."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "blender"))
sys.path.insert(0, str(Path(__file__).parents[1] / "model"))

from network_watch import RECORD, ROOT, chona, watched, write_watch, write_watched_python
from operation_helpers import SCRIPTS, bpy_pythons, needs_worker, run_bpy

pytestmark = pytest.mark.faults


def test_no_command_opens_a_connection(tmp_path: Path) -> None:
    """Those that ``test_hostile_names`` does not run under the same watch."""
    from cli_files import write_capture, write_tiny_shot

    capture = write_capture(tmp_path / "capture")
    trained = chona("train", "--data", capture, "--out", tmp_path / "run", "--steps", "2", cwd=tmp_path)
    assert trained.returncode == 0, trained.stderr
    model, shot = tmp_path / "run" / "model.safetensors", write_tiny_shot(tmp_path / "walk.shot.npz", capture, frames=1)
    for words, made in (
        (("doctor", "--bundle", tmp_path / "report.zip", "--about", tmp_path / "run"), "report.zip"),
        (("evaluate", "--model", model, "--data", capture, "--json", tmp_path / "e.json"), "e.json"),
        (("estimate", "--model", model, "--shot", shot, "--preset", "draft", "--seconds", "0.1"), ""),
        (("farm", "flamenco", "--out", tmp_path / "scripts"), "scripts"),
    ):  # fmt: skip
        done = chona(*words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert (tmp_path / made).exists()


@pytest.mark.slow
@pytest.mark.bpy
@pytest.mark.parametrize("python", bpy_pythons()[:1])
def test_nothing_of_the_add_on_opens_a_connection(tmp_path: Path, python: str) -> None:
    """Trained, baked, previewed and estimated, and Set Up Worker looked at; Blender and its worker under watch."""
    needs_worker(python)
    from cli_files import write_capture

    watch, capture = write_watch(tmp_path), write_capture(tmp_path / "capture")
    environment = {
        "PYTHONPATH": ":".join(map(str, (watch, ROOT, SCRIPTS))), RECORD: str(tmp_path / "watched.txt"),
        "CHONA_WORKER_PYTHON": str(write_watched_python(tmp_path)),
    }  # fmt: skip
    answer = run_bpy(python, "network.py", capture, tmp_path, environment=environment, seconds=500.0)
    assert watched(tmp_path) == ""
    assert answer["watch"] == str(watch / "sitecustomize.py")
    assert answer["checked"] == answer["data"] == answer["baked"] == answer["estimated"] == ["FINISHED"]
    assert answer["trained"] == [["run", "DONE"]] and answer["frames"] == ["walk_0001.exr"]
    assert answer["live"] in {"draft", "preview", "final"}
    assert any("To download" in line or "pypi.org" in line for line in answer["outlook"])
    # The same watch in the same processes, and a line that does connect: in a Python of Blender's, and in a worker.
    assert [code for code, _ in answer["control"]] == [97, 97], json.dumps(answer["control"])
    assert all("127.0.0.1" in record and record.startswith("socket.") for _, record in answer["control"])
