"""Blur against Cycles: the same plane, camera, shutter and lens, rendered by Blender and from the add-on's shot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from operation_helpers import bpy_pythons, needs_worker, run_bpy, write_header_only_model
from PIL import Image

pytestmark = pytest.mark.bpy

SHARP_ARRAYS = {"frames", "camera.clip", "camera.intrinsics", "camera.world_from_camera"}


@pytest.fixture(scope="module", params=bpy_pythons())
def cases(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict]:
    """Every case with its pictures' alphas: Cycles' and ours."""
    needs_worker(request.param)
    from blur_scenes import Card

    from chona_model.blur import BlurChoice
    from chona_model.formats.shot import read_shot
    from chona_model.frame import ShotRenderer
    from chona_model.settings import RENDER_PRESETS

    folder = tmp_path_factory.mktemp("blur")
    answer = run_bpy(request.param, "blur_cycles.py", folder, write_header_only_model(folder / "model.safetensors"))
    for case in answer.values():
        shot = read_shot(Path(case["shot"]))
        renderer = ShotRenderer([Card((0.3, 0.2))], shot, RENDER_PRESETS["exact"], blur=BlurChoice().of(shot))
        case["ours"] = renderer.render(0).combined[..., 3].astype(np.float64)
        case["cycles"] = np.asarray(Image.open(case["picture"]))[..., 3] / 255.0
        case["content"] = shot
    return answer


def moments(alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and standard deviation along x and y, pixels."""
    x, y = np.meshgrid(np.arange(alpha.shape[1]) + 0.5, np.arange(alpha.shape[0]) + 0.5)
    share = alpha / alpha.sum()
    centre = np.array([(share * x).sum(), (share * y).sum()])
    return centre, np.sqrt([(share * (x - centre[0]) ** 2).sum(), (share * (y - centre[1]) ** 2).sum()])


NAMES = (
    "sharp", "starts", "centred", "ends", "shutter curve", "moving camera", "zooming", "behind the focus",
    "before the focus", "five blades", "orthographic", "focus object", "focus bone", "all",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_blurs_are_as_wide_as_cycles(cases: dict[str, dict], name: str) -> None:
    """Place and width of what shows, in pixels, and the whole picture in means over four by four of them."""
    ours, cycles = cases[name]["ours"], cases[name]["cycles"]
    assert cycles.max() > 0.15
    (place, width), (true_place, true_width) = moments(ours), moments(cycles)
    # Cycles looks times up in tables of 256: of the longest way here, 27 pixels, that is a tenth of one.
    np.testing.assert_allclose(place, true_place, atol=0.1)
    np.testing.assert_allclose(width, true_width, atol=0.1)
    assert ours.sum() == pytest.approx(cycles.sum(), rel=0.01)
    height, across = ours.shape
    blocks = (ours - cycles).reshape(height // 4, 4, across // 4, 4).mean(axis=(1, 3))
    assert np.abs(blocks).max() < 0.025
    assert len(cases) == len(NAMES)


def test_the_pictures_are_blurred_at_all(cases: dict[str, dict]) -> None:
    """Each in its own way, else the comparison above shows nothing."""
    sharp = moments(cases["sharp"]["cycles"])[1]
    for name in NAMES[1:]:
        assert np.abs(moments(cases[name]["cycles"])[1] - sharp).max() > 0.8, name
    centres = [moments(cases[name]["cycles"])[0][0] for name in ("ends", "centred", "starts")]
    assert centres[0] + 3 < centres[1] < centres[2] - 3


def test_a_sharp_scene_writes_nothing_about_blur(cases: dict[str, dict]) -> None:
    own = {"actor.0.world_from_bone", "actor.0.world_from_object"}
    assert set(cases["sharp"]["arrays"]) == SHARP_ARRAYS | own
    assert {name for name in cases["five blades"]["arrays"] if name.startswith("shutter")} == set()
    assert {name for name in cases["starts"]["arrays"] if name.startswith("lens")} == set()
    assert all(case["frame"] == 13 for case in cases.values()), "the animator's frame was changed"


def test_the_focus_is_where_the_object_or_its_bone_stands(cases: dict[str, dict]) -> None:
    """Along the camera's axis, in the frame that is rendered; radius of the aperture by the f-stop's definition."""
    for name in ("focus object", "focus bone"):
        lens = cases[name]["content"].lens
        assert lens.focus_distance[0] == pytest.approx(2.0, abs=1e-5)
        assert lens.radius[0] == pytest.approx(0.05 / (2 * 0.15), rel=1e-5)
    assert cases["orthographic"]["content"].lens.radius[0] == pytest.approx(1.0 / (2 * 2.0), rel=1e-5)


def test_the_moments_of_the_shutter_bear_the_same_light(cases: dict[str, dict]) -> None:
    """Box: evenly from when it opens; under a curve, the integral of the curve is even."""
    starts = {"starts": 0.0, "centred": -0.3, "ends": -0.6}
    for name, opens in starts.items():
        np.testing.assert_allclose(cases[name]["times"], opens + 0.6 * (np.arange(128) + 0.5) / 128, atol=1e-6)
    shares = np.array(cases["shutter curve"]["times"]) / 0.6
    rising = shares < 0.7
    light = 0.3 * shares + shares**2 / 2.0  # of a curve from 0.3 to 1 at 0.7
    total = 0.7 * 0.65 + 0.3 * 0.8
    np.testing.assert_allclose(light[rising] / total, (np.flatnonzero(rising) + 0.5) / 128, atol=2e-3)


@pytest.mark.parametrize("python", bpy_pythons())
def test_settings_and_options_choose_what_blurs(python: str) -> None:
    answer = run_bpy(python, "blur_settings.py")
    both = {"times": 32, "lens": True, "samples": 16}
    assert answer["as the scene"] == answer["on in a still scene"] == both
    assert answer["still scene"] == answer["motion off"] == both | {"times": 0}
    assert answer["all off"] is None and answer["no shutter"] is True
    assert answer["lens off, fewer"] == {"times": 10, "lens": False, "samples": 5}
    assert answer["closed shutter"] == both | {"lens": False}
    assert "is zero everywhere, so no light comes in. Reset it under Motion Blur" in answer["dark"]
    assert answer["panel"] == ["CHONA_PT_bake", ["DEFAULT_CLOSED"]]
