"""The figure's shadow and reflection through its stand-in, by pixels: where the sun puts them, and nowhere else.

The box hangs from 1 to 1.5 above the floor, half a unit wide, and the sun comes along (1, 0, -1): its shadow is from
x = 0.75 to 1.75. The mirror turns the camera's downward rays to the right, onto the box's side.
"""

from __future__ import annotations

import math

import numpy as np
import OpenEXR
import pytest
from operation_helpers import bpy_pythons, run_bpy

WIDTH, HEIGHT, UNIT = 32, 16, 8
LIT = 0.8 * math.cos(math.pi / 4)
"""Of a Lambertian surface of albedo 0.8 in a sun of π W/m² at 45 degrees."""

pytestmark = pytest.mark.bpy


def block(left: float, right: float, low: float, high: float) -> tuple[slice, slice]:
    """Pixels of a rectangle of the floor, in units from the picture's middle."""
    columns = slice(round((left + 2) * UNIT), round((right + 2) * UNIT))
    return slice(round((1 - high) * UNIT), round((1 - low) * UNIT)), columns


SHADOW = block(0.75, 1.75, -0.25, 0.25)
UNDER_BOX = block(-0.25, 0.25, -0.25, 0.25)
REFLECTION = block(-1.625, -1.375, -0.125, 0.125)


@pytest.fixture(scope="module", params=bpy_pythons())
def pictures(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """Red channels by name, in one version of Blender; the composited layer is empty."""
    folder = tmp_path_factory.mktemp("shadow")
    channels = {
        "CHONA.Combined": np.zeros((HEIGHT, WIDTH, 4), np.float16),
        "CHONA.Depth.Z": np.full((HEIGHT, WIDTH), 1e10, np.float32),
    }
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(folder / "empty_0001.exr"))
    answer = run_bpy(request.param, "composite_shadow.py", folder, folder)
    caster, holdout = ["box", False, False], ["CHONA empty front box", False, True]
    assert sorted(answer["both"]) == sorted([caster, holdout])
    files = (path for path in folder.glob("*.exr") if path.stem != "empty_0001")
    return {
        path.stem: OpenEXR.File(str(path), separate_channels=True).channels()["R"].pixels.astype(float)
        for path in files
    }


def test_the_shadow_falls_where_the_sun_puts_it(pictures: dict[str, np.ndarray]) -> None:
    np.testing.assert_allclose(pictures["none"][SHADOW], LIT, rtol=1e-3)
    np.testing.assert_allclose(pictures["shadows"][SHADOW], 0.0, atol=1e-4)
    shadow = np.zeros((HEIGHT, WIDTH), bool)
    shadow[SHADOW] = True
    floor = ~shadow
    floor[:, : WIDTH // 2 - 4] = False  # the mirror
    np.testing.assert_allclose(pictures["shadows"][floor], LIT, rtol=1e-3)


def test_the_stand_in_itself_is_not_seen(pictures: dict[str, np.ndarray]) -> None:
    """Neither in the picture, where its lit top would be, nor in the depth that layers are compared with."""
    np.testing.assert_allclose(pictures["shadows"][UNDER_BOX], LIT, rtol=1e-3)
    np.testing.assert_allclose(pictures["shadows depth"][UNDER_BOX], 10.0, rtol=1e-5)
    np.testing.assert_array_equal(pictures["shadows depth"], pictures["none depth"])


def test_the_mirror_shows_it(pictures: dict[str, np.ndarray]) -> None:
    np.testing.assert_allclose(pictures["none"][REFLECTION], 0.0, atol=1e-4)
    np.testing.assert_allclose(pictures["shadows"][REFLECTION], LIT, rtol=1e-3)


def test_refined_edges_change_nothing_of_it(pictures: dict[str, np.ndarray]) -> None:
    np.testing.assert_allclose(pictures["both"], pictures["shadows"], atol=1e-4)


def test_switched_off_again_it_is_gone(pictures: dict[str, np.ndarray]) -> None:
    np.testing.assert_array_equal(pictures["taken back"], pictures["none"])
