"""The composite, checked by pixels: synthetic frames of known colour, alpha and depth against known geometry.

The frames are written with OpenEXR here, the scene is rendered by Blender with the tree that the add-on builds, and
what has to be seen is computed here by hand.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from operation_helpers import bpy_pythons, run_bpy

WIDTH, HEIGHT = 32, 16
LAYER_DEPTH = 5.0
EMPTY = 1e10
FRONT, BEHIND, BEHIND_TOO = (0.8, 0.1, 0.1), (0.1, 0.7, 0.1), (0.1, 0.1, 0.6)

pytestmark = pytest.mark.bpy


def layer_colour(number: int) -> np.ndarray:
    """A colour that tells which frame it is from."""
    return np.array([0.05 * number, 0.3, 1.0 - 0.05 * number])


def row_alpha() -> np.ndarray:
    """Alpha 1, 1/2 and 0 in three bands of rows."""
    alpha = np.ones(HEIGHT)
    alpha[6:11] = 0.5
    alpha[11:] = 0.0
    return alpha


def write_frame(path: Path, number: int, distance: float | None = LAYER_DEPTH) -> None:
    """One frame as docs/file-formats.md has it."""
    alpha = np.repeat(row_alpha()[:, None], WIDTH, axis=1)
    colour = np.concatenate([alpha[..., None] * layer_colour(number), alpha[..., None]], axis=-1)
    channels = {"CHONA.Combined": colour.astype(np.float16)}
    if distance is not None:
        channels["CHONA.Depth.Z"] = np.where(alpha > 0, distance, EMPTY).astype(np.float32)
    for name in ("Human", "Object", "Confidence"):
        channels[f"CHONA.{name}.V"] = alpha.astype(np.float16)
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, "chona:preset": "draft"}
    OpenEXR.File(header, channels).write(str(path))


def read(path: Path) -> np.ndarray:
    """The pixels that Blender rendered, [H, W, 4]."""
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return np.stack([channels[name].pixels for name in "RGBA"], axis=-1)


def expected(number: int | None, film_transparent: bool) -> np.ndarray:
    """What has to be seen: the layer at depth 5 between planes at 3 and 8."""
    scene = np.zeros((HEIGHT, WIDTH, 4))
    scene[..., 3] = 0.0 if film_transparent else 1.0
    for column, colour in ((0, FRONT), (1, BEHIND), (3, BEHIND_TOO)):
        scene[:, column * 8 : column * 8 + 8] = (*colour, 1.0)
    if number is None:
        return scene
    alpha = row_alpha()[:, None, None]
    layer = np.concatenate([alpha * layer_colour(number), alpha], axis=-1)
    over = layer + scene * (1.0 - alpha)
    over[:, :8] = scene[:, :8]
    return over


@pytest.fixture(scope="module", params=bpy_pythons())
def rendered(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """Frames 4, 6, 7, 8 and 9 of `walk` (5 is missing), 0 to 2 of `zero`; rendered in one version of Blender."""
    folder = tmp_path_factory.mktemp("composite")
    frames, out = folder / "frames", folder / "out"
    frames.mkdir()
    out.mkdir()
    for number in (4, 6, 7, 8, 9):
        write_frame(frames / f"walk_{number:04d}.exr", number)
    for number in (0, 1, 2):
        write_frame(frames / f"zero_{number:04d}.exr", number)
    write_frame(frames / "near_0007.exr", 14, distance=4.0)
    write_frame(frames / "old_-0003.exr", 3)
    write_frame(frames / "flat_0001.exr", 3, distance=None)
    return out, run_bpy(request.param, "operation_composite.py", frames, out)


@pytest.mark.parametrize("film", ["plain", "film"])
@pytest.mark.parametrize("number", [4, 6, 7, 8, 9])
def test_what_is_in_front_is_seen(rendered: tuple[Path, dict], film: str, number: int) -> None:
    """Alpha 1, 1/2 and 0 against a plane in front, two behind and the background; opaque and transparent film."""
    out, _ = rendered
    np.testing.assert_allclose(read(out / f"{film}_{number:04d}.exr"), expected(number, film == "film"), atol=2e-3)


@pytest.mark.parametrize("film", ["plain", "film"])
@pytest.mark.parametrize("number", [3, 12])
def test_frames_outside_the_bake_are_empty(rendered: tuple[Path, dict], film: str, number: int) -> None:
    out, _ = rendered
    np.testing.assert_allclose(read(out / f"{film}_{number:04d}.exr"), expected(None, film == "film"), atol=2e-3)


def test_removed_layer_is_not_seen(rendered: tuple[Path, dict]) -> None:
    out, _ = rendered
    np.testing.assert_allclose(read(out / "plain_removed.exr"), expected(None, False), atol=2e-3)


def test_animation_from_frame_zero_shows_each_file_in_its_frame(rendered: tuple[Path, dict]) -> None:
    out, _ = rendered
    for number in (0, 1, 2):
        np.testing.assert_allclose(read(out / f"zero_{number:04d}.exr")[0, 0, :3], layer_colour(number), atol=2e-3)
    np.testing.assert_allclose(read(out / "zero_0003.exr")[0, 0, :3], 0.0, atol=1e-6)


@pytest.mark.parametrize("order", ["walk_near", "near_walk"])
def test_layers_stack_by_depth(rendered: tuple[Path, dict], order: str) -> None:
    """The nearer of two opaque layers is seen whichever was added first."""
    out, _ = rendered
    picture = read(out / f"{order}.exr")
    np.testing.assert_allclose(picture[:6, :, :3], np.broadcast_to(layer_colour(14), (6, WIDTH, 3)), atol=2e-3)
    np.testing.assert_allclose(picture[11:, :, :3], np.broadcast_to(BEHIND, (5, WIDTH, 3)), atol=2e-3)


def test_nodes_deleted_by_hand(rendered: tuple[Path, dict]) -> None:
    _, answer = rendered
    assert "CHONA walk" in answer["groups after deletion"] and "CHONA walk.001" not in answer["groups after deletion"]
    assert answer["removed after deletion"] == [True, False]


def test_messages(rendered: tuple[Path, dict]) -> None:
    """Words for what was built, what is missing and what is wrong."""
    _, answer = rendered
    assert "CHONA walk" in answer["message"]
    assert any("1 frame is missing" in words for words in answer["warnings"])
    assert answer["device"] == "CPU"
    errors = answer["errors"]
    assert "32 × 16" in errors["walk 50 frames"] and "16 × 8" in errors["walk 50 frames"]
    assert "walk" in errors["other 100 frames"] and "bake first" in errors["other 100 frames"]
    assert "there is no folder" in errors["walk 100 nothing"]
    assert "below 0" in errors["old 100 frames"]
    assert "without the pass 'depth'" in errors["flat 100 frames"]
