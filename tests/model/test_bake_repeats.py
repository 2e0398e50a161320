"""Frames that show the same are rendered once, and are the same pixels under their own numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_files import write_capture, write_tiny_shot
from tiny_models import trained

from chona_model.bake import bake
from chona_model.formats.exr import read_frame
from chona_model.formats.shot import Shot, ShotActor, read_shot, write_shot
from chona_model.frame import ShotRenderer
from chona_model.model_store import save_actor
from chona_model.progress import Progress


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Places in the shot of the frames that are rendered, as they are."""
    places: list[int] = []
    render = ShotRenderer.render

    def counting(self: ShotRenderer, index: int, camera: None = None) -> object:
        places.append(index)
        return render(self, index, camera)

    monkeypatch.setattr(ShotRenderer, "render", counting)
    return places


def write_scene(folder: Path) -> tuple[Path, Path]:
    """A model, and a shot of frames 1, 2, 3 = 1, 4 = 2 and 5, which differs from 1 by its camera alone."""
    model, path = folder / "model.safetensors", folder / "hold.shot.npz"
    save_actor(model, trained()[1].actor(), "chona", {}, {})
    content = read_shot(write_tiny_shot(folder / "walk.shot.npz", write_capture(folder / "capture"), frames=2))
    shot = in_order(content, [0, 1, 0, 1, 0])
    cameras = shot.world_from_camera.copy()
    cameras[4, 0, 3] += 0.1
    write_shot(path, replace(shot, name="hold", world_from_camera=cameras))
    return model, path


def in_order(shot: Shot, order: list[int]) -> Shot:
    """Frames 1, 2, … that show those at the given places of a shot."""
    actors = (
        replace(a, world_from_bone=a.world_from_bone[order], world_from_object=a.world_from_object[order])
        for a in shot.actors
    )
    return replace(
        shot, frames=np.arange(1, len(order) + 1), intrinsics=shot.intrinsics[order], clip=shot.clip[order],
        world_from_camera=shot.world_from_camera[order], actors=tuple(actors),
    )  # fmt: skip


def test_a_hold_is_rendered_once(tmp_path: Path, rendered: list[int]) -> None:
    model, shot = write_scene(tmp_path)
    report = bake(model, shot, tmp_path / "out", None, "preview", False, Progress())
    assert (report.written, report.repeated, rendered) == (5, 2, [0, 1, 4])
    frames = [read_frame(tmp_path / "out" / f"hold_{number:04d}.exr") for number in range(1, 6)]
    assert [header.frame for _, header in frames] == [1, 2, 3, 4, 5]
    np.testing.assert_array_equal(frames[0][0].combined, frames[2][0].combined)
    np.testing.assert_array_equal(frames[1][0].depth, frames[3][0].depth)
    assert np.abs(frames[0][0].combined - frames[4][0].combined).max() > 0.05
    assert bake(model, shot, tmp_path / "out", None, "preview", False, Progress()).skipped == 5


def test_what_an_earlier_run_rendered_is_copied(tmp_path: Path, rendered: list[int]) -> None:
    """Whether it comes before or after; not where everything is to be rendered anew."""
    model, shot = write_scene(tmp_path)
    assert bake(model, shot, tmp_path / "out", [2, 3], "preview", False, Progress()).repeated == 0
    report = bake(model, shot, tmp_path / "out", [1, 4], "preview", False, Progress())
    assert (report.written, report.repeated, rendered) == (2, 2, [1, 2])
    assert not report.left_out.loaded
    assert read_frame(tmp_path / "out" / "hold_0001.exr")[1].frame == 1
    again = bake(model, shot, tmp_path / "out", [1, 3, 4], "preview", True, Progress())
    assert (again.written, again.repeated, rendered) == (3, 1, [1, 2, 0, 3])


def test_a_damaged_twin_is_not_copied(tmp_path: Path, rendered: list[int]) -> None:
    model, shot = write_scene(tmp_path)
    bake(model, shot, tmp_path / "out", [1], "preview", False, Progress())
    path = tmp_path / "out" / "hold_0001.exr"
    path.write_bytes(path.read_bytes()[:-20])
    assert bake(model, shot, tmp_path / "out", [3], "preview", False, Progress()).repeated == 0
    assert rendered == [0, 2]


def test_an_actor_that_stands_still_is_not_rendered_again(tmp_path: Path) -> None:
    """Two actors, of whom one moves, here even out of the picture; then the camera moves."""
    model, path = write_scene(tmp_path)
    content = in_order(read_shot(path), [0, 0, 0, 4])
    (still,) = content.actors
    bones = still.world_from_bone.copy()
    bones[:, :, 1, 3] += 60.0 + np.arange(4)[:, None]
    other = ShotActor("other", still.person, (), still.bones, bones, np.zeros((4, 0, 4, 4)))
    shot = tmp_path / "two.shot.npz"
    write_shot(shot, replace(content, name="two", actors=(still, other)))
    alone = tmp_path / "one.shot.npz"
    write_shot(alone, replace(content, name="one"))
    report = bake(model, shot, tmp_path / "out", None, "draft", False, Progress())
    bake(model, alone, tmp_path / "out", None, "draft", False, Progress())
    assert (report.written, report.repeated, report.left_out.pictures_kept) == (4, 0, 2)
    for number in range(1, 5):
        pair = [read_frame(tmp_path / "out" / f"{name}_{number:04d}.exr")[0] for name in ("two", "one")]
        np.testing.assert_array_equal(pair[0].combined, pair[1].combined)
