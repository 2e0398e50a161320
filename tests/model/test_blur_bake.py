"""Blurred shots as files and baked: what is written, refused and rendered again, and a model's own blur."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from blur_scenes import a_lens
from scene_files import grid_file, without_person, write_poses
from scipy import ndimage

from chona_model.bake import bake, frame_hash
from chona_model.bake_report import BakeReport
from chona_model.blur import Blur, BlurChoice
from chona_model.cli import main
from chona_model.formats.exr import read_frame
from chona_model.formats.exr_structure import check_exr
from chona_model.formats.shot import Lens, Shot, ShotError, Shutter, read_shot, write_shot
from chona_model.frame import ShotRenderer
from chona_model.model_store import load_actor
from chona_model.progress import Progress
from chona_model.settings import RENDER_PRESETS
from chona_model.skeleton import translation

TIMES = (np.arange(16) + 0.5) / 16 - 0.5
WAY = 0.3
"""Metres a frame that the box moves to the right of the picture."""


def moving_shot(path: Path, way: float = WAY, lens: Lens | None = None, samples: int | None = 8) -> Path:
    """A box that moves, and stays where it was at the frame's own time in the shot's other arrays."""
    view = grid_file()[1].views[0]
    write_poses(path, view.camera.scaled(0.5), [without_person(view.pose)], name="fly")
    shot = read_shot(path)
    right = shot.world_from_camera[0, :3, 0]
    boxes = np.stack([translation(way * time * right) @ shot.actors[0].world_from_object[0] for time in TIMES])[None]
    count = len(TIMES)
    shutter = Shutter(
        TIMES, np.repeat(shot.intrinsics[:, None], count, axis=1),
        np.repeat(shot.world_from_camera[:, None], count, axis=1), (np.zeros((1, count, 0, 4, 4)),), (boxes,),
    )  # fmt: skip
    write_shot(path, replace(shot, shutter=shutter, lens=lens, blur_samples=samples))
    return path


def run(folder: Path, shot: Path, **options: object) -> BakeReport:
    return bake(grid_file()[0], shot, folder / "out", None, "preview", False, Progress(), **options)  # type: ignore[arg-type]


def combined(folder: Path) -> np.ndarray:
    return read_frame(folder / "out" / "fly_0001.exr")[0].combined


def test_a_blurred_shot_comes_back_as_it_was_written(tmp_path: Path) -> None:
    shot = read_shot(moving_shot(tmp_path / "a.shot.npz", lens=a_lens(2.0, 0.05, 5, 0.3, 1.5)))
    write_shot(tmp_path / "b.shot.npz", shot)
    again = read_shot(tmp_path / "b.shot.npz")
    assert again.shutter is not None and again.lens is not None and again.blur_samples == 8
    for kind in (Shutter, Lens):
        one, other = (each.shutter if kind is Shutter else each.lens for each in (shot, again))
        for field in fields(kind):
            for left, right in zip(getattr(one, field.name), getattr(other, field.name), strict=True):
                np.testing.assert_array_equal(left, right)
    write_shot(tmp_path / "c.shot.npz", replace(shot, shutter=None, lens=None, blur_samples=None))
    with np.load(tmp_path / "c.shot.npz") as arrays:
        assert not [name for name in arrays if name.startswith(("shutter", "lens", "blur"))]


def test_a_models_blur_is_the_mean_of_its_moments(tmp_path: Path) -> None:
    """Against all moments rendered whole with nine rays a pixel and averaged, in means over four by four pixels."""
    shot = read_shot(moving_shot(tmp_path / "a.shot.npz"))
    actor = load_actor(grid_file()[0], persons=[], objects=["box01"])
    blurred = ShotRenderer([actor], shot, RENDER_PRESETS["preview"], blur=Blur(True, False, 16)).render(0).combined
    fine, total = replace(RENDER_PRESETS["preview"], supersampling=3), np.zeros_like(blurred, dtype=np.float64)
    assert shot.shutter is not None
    for place in shot.shutter.world_from_object[0][0]:
        member = replace(shot.actors[0], world_from_object=place[None])
        total += ShotRenderer([actor], replace(shot, actors=(member,), shutter=None), fine).render(0).combined / 16
    sharp = ShotRenderer([actor], replace(shot, shutter=None), fine).render(0).combined

    def apart(picture: np.ndarray) -> float:
        blocks = ndimage.uniform_filter(picture - total, size=(4, 4, 0))
        return float(np.sqrt((blocks**2).mean()))

    assert np.abs(sharp - total).max() > 0.2, "the box must be blurred"
    assert apart(blurred) < 0.15 * apart(sharp)


def test_switched_off_a_frame_is_the_sharp_one_and_is_not_rendered_again(tmp_path: Path) -> None:
    """The same hash in the file, so a bake without blur finds the sharp shot's frame up to date."""
    path = moving_shot(tmp_path / "a.shot.npz", lens=a_lens(1.0, 0.1))
    shot = read_shot(path)
    write_shot(tmp_path / "sharp.shot.npz", replace(shot, shutter=None, lens=None, blur_samples=None))
    assert run(tmp_path, tmp_path / "sharp.shot.npz").written == 1
    sharp, settings = combined(tmp_path), check_exr(tmp_path / "out" / "fly_0001.exr").text("chona:settings")
    assert "blur" not in settings
    assert run(tmp_path, path, blur=BlurChoice("off", "off")).skipped == 1
    assert run(tmp_path, path).written == 1
    assert np.abs(combined(tmp_path) - sharp).max() > 0.1
    assert '"samples": 8' in check_exr(tmp_path / "out" / "fly_0001.exr").text("chona:settings")
    assert run(tmp_path, path).skipped == 1
    assert run(tmp_path, path, blur=BlurChoice(samples=9)).written == 1
    assert run(tmp_path, path, blur=BlurChoice(focus="off")).written == 1
    assert run(tmp_path, path, blur=BlurChoice("off", "off")).written == 1
    np.testing.assert_array_equal(combined(tmp_path), sharp)


def test_the_hash_knows_everything_that_blurs_and_nothing_else(tmp_path: Path) -> None:
    shot = read_shot(moving_shot(tmp_path / "a.shot.npz", lens=a_lens(2.0, 0.05)))
    settings, both = RENDER_PRESETS["draft"], Blur(True, True, 8)
    own = frame_hash(shot, 0, settings, blur=both)
    assert shot.shutter is not None and shot.lens is not None
    other_times = replace(shot.shutter, world_from_object=(shot.shutter.world_from_object[0][:, ::-1],))
    for changed in (
        replace(shot, shutter=other_times), replace(shot, lens=replace(shot.lens, blades=np.array([6.0]))),
        replace(shot, shutter=replace(shot.shutter, times=TIMES * 2)),
    ):  # fmt: skip
        assert frame_hash(changed, 0, settings, blur=both) != own
        assert frame_hash(changed, 0, settings) == frame_hash(shot, 0, settings)
    still = replace(shot, shutter=replace(shot.shutter, world_from_object=(np.repeat(
        shot.shutter.world_from_object[0][:, :1], 16, axis=1),)))  # fmt: skip
    assert frame_hash(still, 0, settings, blur=Blur(True, False, 8)) == frame_hash(still, 0, settings)


def test_a_bound_and_a_blur_exclude_each_other(tmp_path: Path) -> None:
    path = moving_shot(tmp_path / "a.shot.npz")
    with pytest.raises(ShotError, match="it bounds sharp frames and the shot 'fly' is blurred; raise --blur-samples"):
        run(tmp_path, path, max_error=0.1)
    assert run(tmp_path, path, max_error=0.3, blur=BlurChoice("off")).written == 1


def test_the_command_overrides_the_shot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = moving_shot(tmp_path / "a.shot.npz")
    words = ["bake", "--model", str(grid_file()[0]), "--shot", str(path), "--out", str(tmp_path / "out")]
    assert main([*words, "--depth-of-field", "on"]) == 2
    assert "the shot 'fly' holds no depth of field" in capsys.readouterr().err
    assert main([*words, "--motion-blur", "on", "--blur-samples", "3", "--preset", "draft"]) == 0
    assert '"samples": 3' in check_exr(tmp_path / "out" / "fly_0001.exr").text("chona:settings")
    assert main([*words, "--blur-samples", "0"]) == 2


def broken(shot: Shot, **changes: object) -> Shot:
    assert shot.shutter is not None
    return replace(shot, shutter=replace(shot.shutter, **changes))  # type: ignore[arg-type]


def test_broken_blur_is_refused_by_name_and_frame(tmp_path: Path) -> None:
    shot = read_shot(moving_shot(tmp_path / "a.shot.npz", lens=a_lens(2.0, 0.05)))
    assert shot.shutter is not None and shot.lens is not None
    boxes = shot.shutter.world_from_object[0].copy()
    boxes[0, 3, 0, :3, :3] *= 1.5
    cameras = shot.shutter.world_from_camera.copy()
    cameras[0, 2, 0, 3] = np.nan
    cases = (
        ({"times": TIMES[::-1]}, "expected 1 to 1024 times, increasing"),
        ({"times": TIMES[:5]}, r"shutter.intrinsics has the shape \(1, 16, 3, 3\), expected \(1, 5, 3, 3\)"),
        ({"world_from_object": (boxes,)}, "object 'box01' of actor 'box01' in frame 1 is scaled or sheared"),
        ({"world_from_camera": cameras}, "the camera in frame 1 has a matrix that is not finite"),
    )
    for changes, words in cases:
        with pytest.raises(ShotError, match=words):
            broken(shot, **changes)
    for name, value, words in (
        ("focus_distance", 0.0, "lens.focus_distance in frame 1 is 0, expected more than 0"),
        ("radius", -1.0, "lens.radius in frame 1 is -1"),
        ("ratio", np.nan, "lens.ratio in frame 1 is not finite"),
    ):
        with pytest.raises(ShotError, match=words):
            replace(shot, lens=replace(shot.lens, **{name: np.array([value])}))
    with np.load(tmp_path / "a.shot.npz") as content:
        arrays = dict(content)
    for change, words in (
        ({"blur.samples": np.array(0)}, "blur.samples is 0, expected one whole number from 1 to 1024"),
        ({"lens.blades": np.array([5])}, "'lens.blades' has the type int64, expected float64"),
    ):
        np.savez(tmp_path / "b.shot.npz", **arrays | change)
        with pytest.raises(ShotError, match=words):
            read_shot(tmp_path / "b.shot.npz")
