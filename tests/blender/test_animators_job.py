"""The animator's whole job in every Blender that is given: map a rig, check, bake, composite, render; by pixels.

A Mixamo rig carries a box past a pillar, before a wall of two colours. What has to be seen is computed here from the
baked file and from a render without the layer.
"""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from operation_helpers import bpy_pythons, needs_worker, run_bpy

pytestmark = pytest.mark.bpy
every_blender = pytest.mark.parametrize("python", bpy_pythons())

FRAMES, MIDDLE = range(1, 11), 5
PILLAR = (0.8, 0.1, 0.1)
WALL_DEPTH = 4.6
REACH = 0.2
"""Metres: the surface is at most so far before a joint, or before the middle of the box."""
AGREEMENT = 2.0 / 255.0
"""Between versions of Blender: of a colour from 0 to 1."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("job")


@cache
def job(python: str, folder: Path) -> tuple[Path, dict]:
    """The whole job in one version of Blender, once: the folder of its pictures, and what the script says."""
    needs_worker(python)
    from tiny_models import trained

    from chona_model.grid_actor import GridActor
    from chona_model.model_store import save_actor

    model = folder / "model.safetensors"
    if not model.exists():
        save_actor(model, GridActor(trained()[1].model), "chona", {"preset": "fast"}, {"steps": 1})
    out = folder / str(bpy_pythons().index(python))
    return out, run_bpy(python, "animators_job.py", model, sys.executable, out)


def channels(path: Path) -> dict[str, np.ndarray]:
    """A file's channels without the layer's name: each [H, W]."""
    found = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name.removeprefix("CHONA."): channel.pixels.astype(np.float64) for name, channel in found.items()}


def colour(found: dict[str, np.ndarray], prefix: str = "") -> np.ndarray:
    """[H, W, 3]"""
    return np.stack([found[prefix + name] for name in "RGB"], axis=-1)


def baked(out: Path, number: int) -> dict[str, np.ndarray]:
    return channels(out / "frames" / f"walk_{number:04d}.exr")


def picture(out: Path, kind: str, number: int) -> np.ndarray:
    return colour(channels(out / f"{kind}_{number:04d}.exr"))


@every_blender
def test_every_step_ends_well(python: str, folder: Path) -> None:
    _, answer = job(python, folder)
    assert answer["mapped"] == "Mixamo: 2 of 3 bones, 1 missing"
    assert answer["chosen"] == "Mixamo: 3 of 3 bones"
    assert (answer["checked"], answer["findings"]) == (["FINISHED"], [])
    assert answer["baked"] == ["FINISHED"]
    assert answer["baked again"] == 0
    assert answer["removed"] == [0, False]


@every_blender
def test_the_figure_is_where_the_rig_is(python: str, folder: Path) -> None:
    """Joints and the box, as Blender's camera sees them, are covered by their own matte at their own depth."""
    out, answer = job(python, folder)
    for number in FRAMES:
        found = baked(out, number)
        for part, (column, row, depth) in answer["joints"][str(number)].items():
            matte = found["Object.V" if part == "box" else "Human.V"]
            at = int(row), int(column)
            before = found["Object.V"][at] if part != "box" else 0.0  # the box hides the chest in some frames
            assert matte[at] + before > 0.9, (number, part)
            assert found["Combined.A"][at] > 0.95, (number, part)
            if before < 0.05:
                assert depth - REACH < found["Depth.Z"][at] < depth, (number, part)


@every_blender
def test_the_composite_is_the_bake_over_the_scene(python: str, folder: Path) -> None:
    """The pillar hides the figure, the figure hides the wall, and around it the render is as it was."""
    out, _ = job(python, folder)
    plate = picture(out, "plate", 1)
    pillar = np.abs(plate - PILLAR).max(axis=-1) < 1e-3
    assert 0.03 < pillar.mean() < 0.1
    hidden = 0
    for number in FRAMES:
        found, seen = baked(out, number), picture(out, "composite", number)
        alpha = found["Combined.A"]
        assert found["Depth.Z"][alpha > 0].max() < WALL_DEPTH
        front = alpha[..., None] > 0
        expected = np.where(
            pillar[..., None] | ~front, plate, colour(found, "Combined.") + (1.0 - alpha[..., None]) * plate
        )
        np.testing.assert_allclose(seen, expected, atol=1e-6, err_msg=f"frame {number}")
        np.testing.assert_array_equal(seen[alpha == 0], plate[alpha == 0])
        hidden += int((pillar & (alpha > 0.5)).sum())
        assert np.abs(seen - plate)[(alpha > 0.9) & ~pillar].max() > 0.3
    assert hidden > 100


@every_blender
def test_nothing_is_left_beyond_the_bake_and_after_removal(python: str, folder: Path) -> None:
    out, _ = job(python, folder)
    plate = picture(out, "plate", 1)
    np.testing.assert_array_equal(picture(out, "composite", FRAMES[-1] + 1), plate)
    np.testing.assert_array_equal(picture(out, "removed", MIDDLE), plate)


@every_blender
def test_normals_face_the_camera_and_names_are_there(python: str, folder: Path) -> None:
    """Of what is seen, hardly anything faces away; the Cryptomatte's manifest names person and box."""
    out, _ = job(python, folder)
    found = baked(out, MIDDLE)
    normal = np.stack([found[f"Normal.{axis}"] for axis in "XYZ"], axis=-1)
    solid = found["Combined.A"] > 0.9
    np.testing.assert_allclose(np.linalg.norm(normal[solid], axis=-1), 1.0, atol=0.01)
    assert (normal[solid] @ (0.0, -1.0, 0.0) > 0.0).mean() > 0.9
    assert not normal[found["Combined.A"] == 0].any()
    header = OpenEXR.File(str(out / "frames" / f"walk_{MIDDLE:04d}.exr")).header()
    manifest = next(text for name, text in header.items() if name.endswith("/manifest"))
    assert set(json.loads(manifest)) == {"rig.Sub01", "rig.box01"}


@every_blender
def test_the_stand_in_throws_a_shadow(python: str, folder: Path) -> None:
    """With shadows on, the floor beside the figure gets dark in one place, and nothing gets brighter."""
    out, answer = job(python, folder)
    assert set(answer["stand-in"]) == {"Sub01", "box01"}
    assert all(polygons > 100 and hidden for polygons, hidden in answer["stand-in"].values())
    assert answer["with shadows"] == ["FINISHED"]
    lit, shadow = picture(out, "lit", MIDDLE), picture(out, "shadow", MIDDLE)
    beside = baked(out, MIDDLE)["Combined.A"] == 0
    darker = (lit - shadow).max(axis=-1) > 0.1
    assert 20 < (darker & beside).sum() < 0.05 * beside.size
    assert (shadow - lit)[beside].max() < 0.02


@every_blender
def test_motion_blur_spreads_the_figure(python: str, folder: Path) -> None:
    """As much of it in all, less of it sharp."""
    out, answer = job(python, folder)
    assert answer["blurred"] == ["FINISHED"]
    sharp = baked(out, MIDDLE)["Combined.A"]
    blurred = channels(out / "frames" / f"blurred_{MIDDLE:04d}.exr")["Combined.A"]
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=0.05)
    soft = [((alpha > 0.1) & (alpha < 0.9)).sum() for alpha in (sharp, blurred)]
    assert soft[1] > 1.3 * soft[0]


def test_versions_agree(folder: Path) -> None:
    """The same job gives the same frames in each Blender."""
    pythons = bpy_pythons()
    if len(pythons) < 2:
        pytest.skip("$CHONA_BPY names no second Python with bpy")
    first, *others = (job(python, folder)[0] for python in pythons)
    for number in FRAMES:
        for other in others:
            np.testing.assert_allclose(
                picture(other, "composite", number), picture(first, "composite", number), atol=AGREEMENT
            )
            np.testing.assert_allclose(
                baked(other, number)["Combined.A"], baked(first, number)["Combined.A"], atol=AGREEMENT
            )
