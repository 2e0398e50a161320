"""Layers in users' files: all is as it was when they are gone; several scenes, view layers, libraries, passes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from operation_helpers import bpy_pythons, run_bpy

WIDTH, HEIGHT = 32, 16
COLOUR, NORMAL = (0.6, 0.3, 0.1), (0.0, -0.6, 0.8)
CRYPTO = "CHONA.CryptoActor"
CRYPTO_BITS = 0x80EA4F7E
"""MurmurHash3_32 of Robin.Robin."""

pytestmark = pytest.mark.bpy


def write(path: Path, depth: float = 5.0, passes: tuple[str, ...] = ()) -> None:
    """A frame that is opaque in its left three quarters."""
    alpha = np.zeros((HEIGHT, WIDTH), np.float32)
    alpha[:, : WIDTH * 3 // 4] = 1.0
    header: dict = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    channels = {
        "CHONA.Combined": np.concatenate([alpha[..., None] * COLOUR, alpha[..., None]], axis=-1).astype(np.float16),
        "CHONA.Depth.Z": np.where(alpha > 0, depth, 1e10).astype(np.float32),
    }
    for name in set(passes) & {"Human", "Object", "Confidence"}:
        channels[f"CHONA.{name}.V"] = alpha.astype(np.float16)
    if "Normal" in passes:
        for letter, value in zip("XYZ", NORMAL, strict=True):
            channels[f"CHONA.Normal.{letter}"] = (alpha * value).astype(np.float16)
    if "Crypto" in passes:
        ranks = np.zeros((HEIGHT, WIDTH, 4), np.float32)
        ranks[..., 0] = np.where(alpha > 0, np.array(CRYPTO_BITS, np.uint32).view(np.float32), 0.0)
        ranks[..., 1] = alpha
        channels[f"{CRYPTO}00"] = ranks
        header |= {
            "cryptomatte/1234567/name": CRYPTO,
            "cryptomatte/1234567/hash": "MurmurHash3_32",
            "cryptomatte/1234567/conversion": "uint32_to_float32",
            "cryptomatte/1234567/manifest": f'{{"Robin.Robin":"{CRYPTO_BITS:08x}"}}',
        }
    OpenEXR.File(header, channels).write(str(path))


def read(path: Path) -> np.ndarray:
    """[H, W, 4]."""
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return np.stack([channels[name].pixels for name in "RGBA"], axis=-1)


@pytest.mark.parametrize("python", bpy_pythons())
def test_random_trees_are_as_they_were(python: str, tmp_path: Path) -> None:
    """Nodes, values, links, view layers, objects and data of 15 files, after layers went in and out at random."""
    for name, number in (("walk", 4), ("zero", 0), ("run", 9)):
        write(tmp_path / f"{name}_{number:04d}.exr")
    assert run_bpy(python, "composite_trees.py", tmp_path, 0, 15)["wrong"] == {}


@pytest.fixture(scope="module", params=bpy_pythons())
def cases(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """What happened in all cases, in one version of Blender."""
    folder = tmp_path_factory.mktemp("cases")
    frames, out = folder / "frames", folder / "out"
    frames.mkdir()
    out.mkdir()
    write(frames / "walk_0004.exr")
    write(frames / "near_0004.exr", depth=4.0)
    write(frames / "bare_0004.exr")
    write(frames / "rich_0004.exr", passes=("Human", "Object", "Confidence", "Normal", "Crypto"))
    return out, run_bpy(request.param, "composite_cases.py", frames, out)


def test_depth_is_the_nearest_of_the_view_layers_in_the_picture(cases: tuple[Path, dict]) -> None:
    """Neither layer alone knows what is in front; the scene's own first layer is not asked."""
    out, answer = cases
    assert answer["z passes"] == [["ViewLayer", False], ["second", True], ["third", True]]
    picture = read(out / "layers.exr")
    np.testing.assert_allclose(picture[:, : WIDTH // 2, :3], 0.5, atol=2e-3)
    np.testing.assert_allclose(picture[:, WIDTH // 2 : WIDTH * 3 // 4, :3] - COLOUR, 0.0, atol=2e-3)
    np.testing.assert_allclose(picture[:, WIDTH * 3 // 4 :, :3], 0.5, atol=2e-3)


def test_what_the_user_puts_behind_a_layer_stays_there(cases: tuple[Path, dict]) -> None:
    _, answer = cases
    assert answer["before the grade"] == [True, True]
    assert answer["walk gone"] == [True, True]
    assert answer["both gone"] == [True, 5]


def test_border(cases: tuple[Path, dict]) -> None:
    """Of a region that does not crop: the composite inside, outside the layer alone, for nothing else is rendered."""
    out, answer = cases
    assert answer["size warned"] == ""
    picture = read(out / "border.exr")
    np.testing.assert_allclose(picture[:, 8:16, :3] - COLOUR, 0.0, atol=2e-3)
    np.testing.assert_allclose(picture[:, :24, :3] - COLOUR, 0.0, atol=2e-3)
    np.testing.assert_allclose(picture[:, 24:], 0.0, atol=1e-6)


def test_sizes_and_options_that_do_not_fit_are_told(cases: tuple[Path, dict]) -> None:
    _, answer = cases
    assert answer["size words"] == "Baked at 32 × 16, the scene renders 16 × 8"
    assert "16 × 8" in answer["options refused"][0]
    assert "Edges: Refined needs to know where the figure is" in answer["options refused"][2]
    assert "stand-in" in answer["options refused"][3]
    assert "shot 1, shot 2" in answer["options refused"][4]
    assert answer["view layers after refusal"] == 1


def test_sockets_are_those_whose_passes_the_frames_have(cases: tuple[Path, dict]) -> None:
    _, answer = cases
    always = ["Image", "Depth", "Alpha", "Layers Alpha", "Layers Depth"]
    outputs, mattes, chosen = answer["rich"]
    assert sorted(outputs) == sorted([*always, "Human", "Object", "Confidence", "Normal"])
    assert (mattes, chosen) == (1, ["Robin.Robin"])
    outputs, warnings, mattes = answer["bare"]
    assert sorted(outputs) == sorted(always)
    assert "the frames have no Human, Object, Confidence, Normal any more" in warnings[0]
    assert mattes == 0


def test_mattes_are_what_is_seen(cases: tuple[Path, dict]) -> None:
    """A wall hides the left half; Normal is the layer's own; Cryptomatte picks the person by name."""
    out, _ = cases
    seen = np.zeros((HEIGHT, WIDTH))
    seen[:, WIDTH // 2 : WIDTH * 3 // 4] = 1.0
    for name in ("human", "alpha"):
        np.testing.assert_allclose(read(out / f"pass_{name}.exr")[..., 0], seen, atol=1e-3)
    alpha = np.arange(WIDTH) < WIDTH * 3 // 4
    expected = alpha[None, :, None] * np.array(NORMAL)
    np.testing.assert_allclose(read(out / "pass_normal.exr")[..., :3] - expected, 0.0, atol=1e-3)
    np.testing.assert_allclose(read(out / "pass_matte.exr")[..., 0] - alpha, 0.0, atol=1e-3)


def test_a_layer_of_an_earlier_version_is_brought_up_to_date(cases: tuple[Path, dict]) -> None:
    out, _ = cases
    np.testing.assert_allclose(read(out / "older.exr")[:, : WIDTH * 3 // 4, :3] - COLOUR, 0.0, atol=2e-3)


def test_the_card_keeps_the_figures_distance(cases: tuple[Path, dict]) -> None:
    """Square to the camera, at the depth of the hips, in the front view layer alone."""
    _, answer = cases
    depths = [hips for _, hips, _ in answer["card"]]
    assert len(set(depths)) == 3 and max(depths) < -1.0
    for place, hips, angles in answer["card"]:
        np.testing.assert_allclose([*place, *angles], [0.0, 0.0, hips, 0.0, 0.0, 0.0], atol=1e-5)
    assert answer["card in"] == [["ViewLayer", False], ["CHONA walk front", True]]


def test_stand_ins_of_an_actor_are_given_back(cases: tuple[Path, dict]) -> None:
    """Both cast shadows, then both are holdouts again, the second as invisible to mirrors as it was."""
    _, answer = cases
    caster = [False, False, False, True]
    assert answer["stand-ins"][0] == ["SHADOW", [caster, caster]]
    assert answer["stand-ins"][1] == ["HOLDOUT", [[False, True, True, True], [False, True, True, False]]]


def test_several_scenes(cases: tuple[Path, dict]) -> None:
    """Each has its layer; in 5.x both show one tree, so the layer goes from both."""
    _, answer = cases
    assert answer["two scenes"] == [["walk"], ["walk"]]
    assert answer["removed"] == [True, True]
    assert answer["states"] == [False, False]
    assert answer["groups"] == []


def test_what_is_linked_is_refused(cases: tuple[Path, dict]) -> None:
    _, answer = cases
    for key in ("linked scene", "linked tree"):
        if key in answer:
            assert "library.blend" in answer[key] and "make it local" in answer[key]
    assert answer.get("state after refusal", False) is False
