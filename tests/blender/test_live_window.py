"""The live preview in the real Blender, with a window, through what an animator does while it is on.

$CHONA_BLENDER is the launcher with its own options, for example `blender` or `xvfb-run blender`; it must see the
repository, this Python and pytest's folders. Pictures go to $CHONA_PICTURES where that is set.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from operation_helpers import ROOT, SCRIPTS

pytestmark = pytest.mark.blender
OFF = {"handlers": 1, "timers": 0, "workers": 0, "drawing": 0}
ON = {"handlers": 5, "timers": 1, "workers": 1, "drawing": 1}


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory, blender_launcher: list[str]) -> dict:
    """What was seen, and how Blender ended."""
    pytest.importorskip("torch")
    sys.path.insert(0, str(ROOT / "tests" / "model"))
    from tiny_models import trained

    from chona_model.grid_actor import GridActor
    from chona_model.model_store import save_actor

    out = Path(os.environ.get("CHONA_PICTURES") or tmp_path_factory.mktemp("live_window"))
    out.mkdir(parents=True, exist_ok=True)
    save_actor(out / "model.safetensors", GridActor(trained()[1].model), "chona", {"preset": "fast"}, {"steps": 1})
    command = [*blender_launcher, "--python-use-system-env", "--window-geometry", "0", "0", "1280", "860"]
    command += ["--python", SCRIPTS / "live_window.py", "--", out / "model.safetensors", sys.executable, out]
    environment = os.environ | {
        "BLENDER_USER_RESOURCES": str(out / "resources"), "PYTHONPATH": os.pathsep.join([str(ROOT), str(SCRIPTS)])
    }  # fmt: skip
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    found = json.loads((out / "answer.json").read_text())
    return found | {"said": done.stdout + done.stderr}


def without_images(traces: dict) -> dict:
    return {name: count for name, count in traces.items() if name != "images"}


def test_it_draws_in_every_view_through_the_camera(answer: dict) -> None:
    count, errors = answer["quad"]
    assert count == 1 and max(errors) < 0.5
    count, errors = answer["views in two windows"]
    assert count == 3 and max(errors) < 0.5


def test_it_lies_on_the_cameras_frame(answer: dict) -> None:
    frames = answer["frames"]
    assert frames.keys() == {"zoomed", "rolled", "shifted", "orthographic", "cropped"}
    for name, (*errors, width) in frames.items():
        assert max(errors) < 0.5, name
        assert width == (57 if name == "cropped" else 96), name  # 0.6 of 96 pixels
    switched, moved = answer["marker's camera"]
    assert switched and moved == pytest.approx(1.0)


def test_playback_is_not_slowed_down(answer: dict) -> None:
    playback = answer["playback"]
    assert playback["pictures"] >= 2 and playback["frames"] >= 5
    assert playback["oldest"] < 0.5  # seconds longer than its patience


def test_nothing_stands_still(answer: dict) -> None:
    assert answer["hidden"] == "waiting for the worker"


def test_undo_redo_and_deletion(answer: dict) -> None:
    assert answer["undone"] > 0.5 and answer["redone"] == 0.0
    assert answer["deleted"][0].startswith("No armature poses Sub01") and answer["deleted"][1]
    assert answer["deletion undone"] == ""


def test_renders_are_left_alone(answer: dict) -> None:
    assert answer["renders differ by"] == [0.0, 0.0]


def test_states_that_cannot_be_shown_are_told(answer: dict) -> None:
    told = answer["told"]
    assert told["edit mode"] == ["Armature 'Sub01' is being edited. Leave edit mode first", True]
    assert told["object switched off"] > 0.5 and told["after"] == ""
    error, hidden = answer["model gone"]
    assert "there is no model file" in error.lower() and hidden
    assert answer["model back"][0] == "" and without_images(answer["model back"][1]) == ON


def test_a_worker_that_is_killed_is_told_and_started_again(answer: dict) -> None:
    for error, hidden in answer["killed"]:
        assert error.startswith("The worker was ended by signal 9") and error.endswith("press Start Again") and hidden
    assert answer["waits for the button"] and answer["button"] == ["FINISHED"]
    assert without_images(answer["after restart"]) == ON


def test_other_scenes_and_files(answer: dict) -> None:
    assert answer["other scene"] == [True, False, 0]
    on, traces = answer["scene deleted"]
    assert not on and {**without_images(traces), "workers": 0} == OFF  # the worker stays warm for a minute
    on, traces = answer["after a new file"]
    assert not on and without_images(traces) == OFF


def test_nothing_is_left_behind(answer: dict) -> None:
    assert without_images(answer["before"]) == OFF and without_images(answer["while on"]) == ON
    assert answer["while on"]["images"] == answer["before"]["images"]
    assert answer["memory grew by"] < 60.0  # megabytes over 80 pictures of up to 1.2
    assert without_images(answer["unregistered"]) == OFF | {"handlers": 0}
    worker, began = Path(f"/proc/{answer['worker']}"), time.monotonic()
    while worker.exists() and time.monotonic() - began < 5.0:
        time.sleep(0.1)
    assert not worker.exists(), "the worker outlives Blender"
    assert "Traceback" not in answer["said"] and "Error:" not in answer["said"]
