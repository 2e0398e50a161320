"""Colours all the way: a photograph's pixels as a baked layer, composited and rendered, against themselves."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from operation_helpers import bpy_pythons, run_bpy
from PIL import Image

WIDTH, HEIGHT = 32, 16

pytestmark = pytest.mark.bpy


def plate() -> np.ndarray:
    """[H, W, 3] 8-bit sRGB: greys, the corners of the cube, and colours between."""
    colours = np.random.default_rng(5).integers(0, 256, (HEIGHT, WIDTH, 3))
    colours[0] = np.linspace(0, 255, WIDTH)[:, None]
    colours[1, :8] = [[255 * (n >> 2 & 1), 255 * (n >> 1 & 1), 255 * (n & 1)] for n in range(8)]
    return colours.astype(np.uint8)


def linear(encoded: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, 8 bits to 0…1."""
    value = encoded / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def read(path: Path) -> np.ndarray:
    """[H, W, 3] 8-bit, signed for differences."""
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


@pytest.fixture(scope="module", params=bpy_pythons())
def rendered(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """PNG files `<view transform> <working space> <ours or own>.png` of one version of Blender."""
    folder = tmp_path_factory.mktemp("colours")
    Image.fromarray(plate()).save(folder / "plate.png")
    alpha = np.ones((HEIGHT, WIDTH, 1))
    channels = {
        "CHONA.Combined": np.concatenate([linear(plate()), alpha], axis=-1).astype(np.float16),
        "CHONA.Depth.Z": np.full((HEIGHT, WIDTH), 5.0, np.float32),
    }
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    OpenEXR.File(header, channels).write(str(folder / "plate_0001.exr"))
    return folder, run_bpy(request.param, "composite_colours.py", folder / "plate.png", folder, folder)["made"]


def test_standard_gives_the_photograph_back(rendered: tuple[Path, list[str]]) -> None:
    """The same 8-bit values, one step for half floats; in every working space that this Blender has."""
    folder, made = rendered
    ours = [name for name in made if name.startswith("Standard") and name.endswith("ours.png")]
    assert len(ours) in {1, 3}
    for name in ours:
        assert np.abs(read(folder / name) - plate()).max() <= 1, name


def test_every_view_transform_treats_the_layer_as_blender_does_the_photograph(
    rendered: tuple[Path, list[str]],
) -> None:
    folder, made = rendered
    pairs = [(name, name.replace("ours", "own")) for name in made if name.endswith("ours.png")]
    assert len(pairs) in {3, 9}
    for ours, own in pairs:
        assert np.abs(read(folder / ours) - read(folder / own)).max() <= 1, ours
    looks = [read(folder / name) for name in made if name.endswith("ours.png")][:3]
    assert all(np.abs(first - second).max() > 10 for first, second in pairwise(looks))
