"""A bake goes on, or ends with words and whole frames, whatever is done to scene, file and worker meanwhile.

The real operator with a real worker; its timer's ticks are given by hand, since Blender without a window has none.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from operation_helpers import bpy_pythons, needs_worker, run_bpy, write_two_models

pytestmark = [pytest.mark.bpy, pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")]
FRAMES = 24
NAMES = {*(f"walk_{number:04d}.exr" for number in range(1, FRAMES + 1)), "walk.shot.npz"}
OVER = {"running": False, "timers": [], "children": []}


@pytest.fixture(scope="module", params=bpy_pythons())
def ran(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """Where it happened, and what, in one version of Blender."""
    needs_worker(request.param)
    folder: Path = tmp_path_factory.mktemp("steady")
    model, _ = write_two_models(folder)
    return folder, run_bpy(request.param, "steady_bake.py", model, sys.executable, folder, steady=True, seconds=550)


def check_over(outcome: dict) -> None:
    """No job, no timer and no process is left of a bake."""
    assert outcome | OVER == outcome


def check_same_frames(one: Path, other: Path) -> None:
    """All frames are there, and every pixel is the same."""
    from chona_model.formats.exr import read_frame

    assert {path.name for path in one.iterdir()} == {path.name for path in other.iterdir()} == NAMES
    for name in NAMES - {"walk.shot.npz"}:
        (left, _), (right, _) = read_frame(one / name), read_frame(other / name)
        np.testing.assert_array_equal(left.combined, right.combined)
        np.testing.assert_array_equal(left.depth, right.depth)


def test_it_renders_what_the_scene_was_when_it_began(ran: tuple[Path, dict]) -> None:
    """Undo, redo, another output and deleted objects change nothing of it; its own scene is composited."""
    folder, answer = ran
    changed = answer["changed"]
    assert answer["undone"] == [["FINISHED"]] * 2
    assert (changed["result"], changed["status"], changed["error"]) == (["FINISHED"], "DONE", "")
    assert changed["same scene"] and changed["layers"] == [["walk"], []] and changed["elsewhere"] == []
    check_over(changed)
    assert {path.name for path in (folder / "changed").iterdir()} == NAMES


def test_all_frames_are_of_one_model_and_a_new_one_is_told(ran: tuple[Path, dict]) -> None:
    answer = ran[1]
    replaced = answer["replaced"]
    assert replaced["result"] == ["FINISHED"] and replaced["said"]["written"] == FRAMES
    assert replaced["told"] == (
        "The model file was replaced during the bake: all frames are of the model before; bake again for the new one"
    )
    check_over(replaced)
    assert "model_replaced" not in answer["changed"]["said"]


def test_a_killed_worker_is_told_and_the_bake_goes_on(ran: tuple[Path, dict]) -> None:
    folder, answer = ran
    killed, again = answer["killed"], answer["gone on"]
    there = int(killed["done"])
    assert (killed["result"], killed["status"], 3 <= there < FRAMES) == (["CANCELLED"], "FAILED", True)
    assert killed["told"].startswith("The worker was ended by signal 9 (out of memory?)")
    assert killed["told"].endswith(f"; {there} of {FRAMES} frames are there; bake again to go on with the rest")
    assert set(killed["names"]) >= {f"walk_{number:04d}.exr" for number in range(1, there + 1)}
    check_over(killed)
    assert again["result"] == ["FINISHED"] and again["said"]["skipped"] >= there and again["told"] == ""
    assert again["said"]["written"] + again["said"]["skipped"] == FRAMES
    check_over(again)
    check_same_frames(folder / "killed", folder / "replaced")


def test_another_file_ends_it_with_words_and_whole_frames(ran: tuple[Path, dict]) -> None:
    from chona_model.formats.exr_structure import is_whole

    folder, answer = ran
    opened = answer["opened"]
    assert opened["status"] == "CANCELLED" and opened["folder"] == str(folder / "killed")
    assert opened["told"].startswith("Another file was opened, or the window was closed: Bake walk (draft, ")
    assert "was cancelled; " in opened["told"] and "bake again to go on with the rest" in opened["told"]
    check_over(opened)
    frames = list((folder / "opened").glob("walk_*.exr"))
    assert int(opened["done"]) <= len(frames) < FRAMES and all(is_whole(path) for path in frames)
    assert {path.name for path in (folder / "opened").iterdir()} <= NAMES
    for name in ("reverted", "factory"):
        assert answer[name]["status"] == "CANCELLED"
        assert answer[name]["told"].endswith("was cancelled; no frame was begun; bake again"), name
        check_over(answer[name])
