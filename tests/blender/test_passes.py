"""Passes as Blender sees them: mattes that its own Cryptomatte node picks, and normals beside Cycles'."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from operation_helpers import bpy_pythons, needs_worker, run_bpy, write_header_only_model

from chona_model.cryptomatte import Mattes, matte_id
from chona_model.formats.exr import FrameHeader, FrameLayers, write_frame

pytestmark = pytest.mark.bpy
every_blender = pytest.mark.parametrize("python", bpy_pythons())

WIDTH, HEIGHT, FIRST = 32, 16, 3
NAMES = ("Robin.Robin", "Robin.crate", "Élise's twin.Élise", 'the "dog" \\ 2.ball', "Hero.sofa")
PERSONS = [0, 2]


def frame(number: int) -> FrameLayers:
    """Some names in most pixels, none in some; their persons and objects are the plain mattes."""
    random = np.random.default_rng(number)
    shares = random.random((HEIGHT, WIDTH, len(NAMES))) * (random.random((HEIGHT, WIDTH, len(NAMES))) < 0.5)
    shares /= np.maximum(shares.sum(axis=-1, keepdims=True), 1.0)
    shares = shares.astype(np.float32)
    combined = np.repeat(shares.sum(axis=-1)[..., None], 4, axis=-1)
    human = shares[..., PERSONS].sum(axis=-1)
    return FrameLayers(
        combined, np.ones((HEIGHT, WIDTH)), human, combined[..., 3] - human, cryptomatte=Mattes(NAMES, shares)
    )


def red(path: Path) -> np.ndarray:
    return OpenEXR.File(str(path), separate_channels=True).channels()["R"].pixels


@every_blender
def test_blenders_cryptomatte_node_picks_every_name(python: str, tmp_path: Path) -> None:
    """Each name alone and the persons together, in two frames of a sequence."""
    frames = {number: frame(number) for number in (FIRST, FIRST + 1)}
    for number, layers in frames.items():
        header = FrameHeader("m" * 64, "s" * 64, "final", "{}", 1.0, number)
        write_frame(tmp_path / f"pick_{number:04d}.exr", layers, header)
    picks = [[name] for name in NAMES] + [[NAMES[k] for k in PERSONS]]
    answer = run_bpy(python, "passes_picks.py", tmp_path, FIRST, json.dumps(picks))
    assert answer["layer"] == "CHONA.CryptoActor"
    hashed = {name: np.float32(value) for name, value in answer["ids"].items()}
    assert hashed == {name: matte_id(name) for name in NAMES}, "Blender's own hashes"
    for place, names in enumerate(picks):
        for number, layers in frames.items():
            assert layers.cryptomatte is not None and layers.human is not None
            matte = red(tmp_path / f"matte_{place}_{number}.exr")
            coverage = layers.cryptomatte.coverage[..., [NAMES.index(name) for name in names]].sum(axis=-1)
            np.testing.assert_allclose(matte, coverage, atol=1e-6, err_msg=f"{names} in frame {number}")
    with OpenEXR.File(str(tmp_path / f"pick_{FIRST:04d}.exr")) as file:
        human = file.channels()["CHONA.Human.V"].pixels
        assert human.dtype == np.float16
    np.testing.assert_allclose(red(tmp_path / f"matte_{len(NAMES)}_{FIRST}.exr"), human, atol=5e-4)


@every_blender
def test_normals_are_cycles_normals(python: str, tmp_path: Path) -> None:
    """The same ball, as fog on a grid and as a mesh, through the same cameras."""
    needs_worker(python)
    from ball_model import RADIUS, ball_actor, ball_pose

    from chona_model.camera import Camera
    from chona_model.frame import unit_normals
    from chona_model.passes import Passes
    from chona_model.settings import RENDER_PRESETS

    answer = run_bpy(python, "passes_normal.py", tmp_path, RADIUS)
    assert len(answer) == 2
    for name, each in answer.items():
        camera = Camera(np.array(each["intrinsics"]), np.array(each["world_from_camera"]), 48, 40)
        frame = np.eye(4)
        frame[:3, 3] = each["centre"]
        picture = ball_actor().render(ball_pose(frame), camera, RENDER_PRESETS["final"], passes=Passes(normal=True))
        with OpenEXR.File(str(tmp_path / f"{name}.exr"), separate_channels=True) as file:
            pixels = {
                path.split(".", 1)[1]: channel.pixels for part in file.parts for path, channel in part.channels.items()
            }
        theirs = np.stack([pixels[f"Normal.{axis}"] for axis in "XYZ"], axis=-1)
        seen = (pixels["Combined.A"] > 0.99) & (picture.alpha > 0.95) & (np.linalg.norm(theirs, axis=-1) > 0.97)
        assert seen.sum() > 150 and picture.normal is not None, name
        theirs = theirs[seen] / np.linalg.norm(theirs[seen], axis=-1, keepdims=True)
        angles = np.degrees(np.arccos(np.clip((theirs * unit_normals(picture.normal)[seen]).sum(axis=-1), -1, 1)))
        assert angles.mean() < 3.0 and np.quantile(angles, 0.99) < 10.0, f"{name}: {angles.mean():.1f} degrees"


@every_blender
def test_passes_are_chosen_in_the_scene_and_in_the_command(python: str, tmp_path: Path) -> None:
    needs_worker(python)
    model, told = write_header_only_model(tmp_path / "model.safetensors"), tmp_path / "told.txt"
    worker = tmp_path / "worker"
    worker.write_text(f'#!/bin/sh\necho "$@" >> "{told}"\nexec "{sys.executable}" "$@"\n')
    worker.chmod(0o755)
    answer = run_bpy(python, "passes_choice.py", model, tmp_path / "out", worker)
    assert answer["default"] == ["combined", "depth", "mattes", "confidence", "cryptomatte"]
    words = told.read_text().split()
    assert words[words.index("--passes") + 1] == "combined,normal,cryptomatte"
    code, words = answer["unknown"]
    assert code == 2 and "no pass 'normals'" in words and "normal, cryptomatte" in words
    code, words = answer["no depth"]
    assert code == 2 and "Depth" in words and "Bake > Passes" in words
