"""Cryptomattes against the specification's own numbers, files read back, and pictures of several actors."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from scene_files import write_poses
from tiny_capture import tiny_capture
from tiny_models import SETTINGS, SHAPE

from chona_model.actor import Samples, empty_picture
from chona_model.bake import bake
from chona_model.bake_report import BakeReport
from chona_model.camera import Camera
from chona_model.cryptomatte import Mattes, attributes, collect, level_count, matte_id, murmur3, names_of, rank, unrank
from chona_model.data.dataset import Pose
from chona_model.formats.exr import CRYPTO_LAYER, ExrError, FrameHeader, FrameLayers, read_frame, write_frame
from chona_model.formats.shot import Shot, read_shot, write_shot
from chona_model.frame import matte_names, render_frame
from chona_model.model_store import load_actor, save_actor
from chona_model.passes import Passes
from chona_model.progress import Progress
from chona_model.samples import composite
from chona_model.settings import RENDER_PRESETS
from chona_model.skeleton import translation
from chona_model.train.grid_trainer import GridTrainer

WITH_MATTES = Passes(cryptomatte=True)
HEADER = FrameHeader("m" * 64, "s" * 64, "final", "{}", 1.0, 1)

MURMUR3 = [
    ("", 0, 0), ("", 1, 0x514E28B7), ("hello", 0, 0x248BFA47), ("bunny", 0, 0x13851A76), ("default", 0, 0x42C9679F),
    ("The quick brown fox jumps over the lazy dog", 0x9747B28C, 0x2FA826CD),
]  # fmt: skip
"""Texts, seeds and hashes: Appleby's, and the manifest that the specification prints."""

IDS = {
    "hello": 6.0705627102400005616e-17, "cube": -4.08461912519e15, "sphere": 2.79018604383e15,
    "plane": 3.66557617593e-11, "равнина": -1.3192631212399999468e-25, "mädchen": 6.2361298211599995797e25,
}  # fmt: skip
"""Names and floats of the reference implementation's tests (Psyop, BSD-3)."""


@pytest.mark.parametrize(("text", "seed", "value"), MURMUR3)
def test_hashes_are_those_of_the_specification(text: str, seed: int, value: int) -> None:
    assert murmur3(text, seed) == value


@pytest.mark.parametrize(("name", "value"), IDS.items())
def test_ids_are_those_of_the_reference_implementation(name: str, value: float) -> None:
    assert matte_id(name) == np.float32(value)


def test_every_id_is_a_normal_number() -> None:
    """Hashes whose exponent is all zeros or all ones have one bit turned; there is one such among some 128 names."""
    names = [f"actor{number}.thing" for number in range(4000)]
    odd = [name for name in names if murmur3(name) >> 23 & 0xFF in {0, 0xFF}]
    assert len(odd) > 10
    for name in odd:
        number = matte_id(name)
        assert math.isfinite(number) and abs(number) >= np.finfo(np.float32).tiny
        assert int(number.view(np.uint32)) == murmur3(name) ^ 1 << 23
    assert all(int(matte_id(name).view(np.uint32)) == murmur3(name) for name in set(names) - set(odd))


def test_the_header_names_the_layer_and_its_ids() -> None:
    names = ("Robin.Robin", 'Élise "x" \\ y.chair, red')
    found = attributes(CRYPTO_LAYER, names)
    key = f"cryptomatte/{murmur3('CHONA.CryptoActor'):08x}"[:19]
    assert (found[f"{key}/name"], found[f"{key}/hash"]) == ("CHONA.CryptoActor", "MurmurHash3_32")
    assert found[f"{key}/conversion"] == "uint32_to_float32"
    manifest = json.loads(found[f"{key}/manifest"])
    assert tuple(manifest) == names
    for name, digits in manifest.items():
        assert np.uint32(int(digits, 16)).view(np.float32) == matte_id(name) and len(digits) == 8
    assert names_of(CRYPTO_LAYER, found) == names
    assert names_of("CHONA.CryptoMaterial", found) is None


def random_mattes(count: int, shape: tuple[int, int] = (5, 7)) -> Mattes:
    """Some pixels empty, most names absent from most others."""
    random = np.random.default_rng(count)
    shares = random.random((*shape, count)) * (random.random((*shape, count)) < 0.6)
    shares[:2] = 0.0
    shares /= np.maximum(shares.sum(axis=-1, keepdims=True), 1.0)
    return Mattes(tuple(f"a{k}.b" for k in range(count)), shares.astype(np.float32))


@pytest.mark.parametrize("count", [1, 3, 4, 6])
def test_ranks_fall_and_hold_everything(count: int) -> None:
    mattes = random_mattes(count)
    levels = rank(mattes)
    assert len(levels) == level_count(mattes.names) == (2 if count <= 4 else 3)
    pairs = np.concatenate([level.reshape(5, 7, 2, 2) for level in levels], axis=2)
    assert (np.diff(pairs[..., 1], axis=2) <= 0).all(), "the greatest coverage comes first"
    np.testing.assert_allclose(pairs[..., 1].sum(axis=2), mattes.coverage.sum(axis=-1), atol=1e-6)
    assert ((pairs[..., 0] == 0) == (pairs[..., 1] == 0)).all(), "what covers nothing has no id"
    np.testing.assert_array_equal(unrank(levels, mattes.names).coverage, mattes.coverage)


def test_of_many_names_a_pixel_keeps_those_that_cover_most() -> None:
    mattes = random_mattes(20)
    kept = unrank(rank(mattes), mattes.names).coverage
    largest = np.sort(mattes.coverage, axis=-1)[..., ::-1][..., :6]
    np.testing.assert_allclose(np.sort(kept, axis=-1)[..., ::-1][..., :6], largest)
    assert ((kept == mattes.coverage) | (kept == 0)).all()


def test_things_of_one_name_are_one() -> None:
    shares = np.array([[[0.1, 0.2, 0.3]]], np.float32)
    mattes = collect(("a.box", "a.cup", "a.box"), shares)
    assert mattes.names == ("a.box", "a.cup")
    np.testing.assert_allclose(mattes.coverage, [[[0.4, 0.2]]], atol=1e-7)


def test_files_hold_what_was_written(tmp_path: Path) -> None:
    mattes, path = random_mattes(6), tmp_path / "a_0001.exr"
    layers = FrameLayers(np.zeros((5, 7, 4), np.float32), cryptomatte=mattes)
    write_frame(path, layers, HEADER)
    with OpenEXR.File(str(path)) as file:
        names = [channel.name for channel in file.header()["channels"]]
        types = {str(channel.pixels.dtype) for name, channel in file.channels().items() if "Crypto" in name}
    assert [name for name in names if "Crypto" in name] == [
        f"CHONA.CryptoActor{level}.{letter}" for level in ("00", "01", "02") for letter in "ABGR"
    ]
    assert types == {"float32"}, "ids do not survive half precision"
    again, _ = read_frame(path)
    assert again.cryptomatte is not None and again.cryptomatte.names == mattes.names
    np.testing.assert_array_equal(again.cryptomatte.coverage, mattes.coverage)
    with pytest.raises(ExrError, match=r"cryptomatte has the shape \(5, 6, 6\), expected \(5, 7, 6\)"):
        write_frame(path, replace(layers, cryptomatte=Mattes(mattes.names, mattes.coverage[:, 1:])), HEADER)


def one_ray(depths: list[float], alphas: list[float], parts: list[list[float]]) -> Samples:
    """Samples of pixel (0, 0)."""
    count, shares = len(depths), np.array(parts, np.float32)
    return Samples(
        np.zeros(count, np.int64), np.array(depths, np.float32), np.array(alphas, np.float32),
        np.zeros((count, 3), np.float32), shares[:, -1], None, shares,
    )  # fmt: skip


def test_coverage_of_two_interleaved_actors_by_hand() -> None:
    """The first has a person and an object, the second an object alone, between the two."""
    camera = Camera(np.eye(3), np.eye(4), 1, 1)
    first = one_ray([1.0, 3.0], [0.5, 0.5], [[1.0, 0.0], [0.25, 0.75]])
    second = one_ray([2.0, 4.0], [0.4, 1.0], [[1.0], [1.0]])
    nothing = empty_picture(camera, WITH_MATTES, 3)
    picture = composite([first, second], camera, 1, nothing, np.ones((1, 1), bool))
    # Light: 1 | 0.5 at the second's first sample | 0.3 | 0.15 | 0.
    assert picture.parts is not None
    np.testing.assert_allclose(picture.parts[0, 0], [0.5 + 0.25 * 0.15, 0.75 * 0.15, 0.5 * 0.4 + 0.15], atol=1e-6)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Camera, Pose, Pose]:
    """A model with room for two objects a pose; Sub01 with box01 and box02, and Sub02 a little aside."""
    folder = tmp_path_factory.mktemp("scene")
    dataset = tiny_capture(folder, persons=2, objects=2, frames=1, cameras=2, size=(48, 36))
    trainer = GridTrainer(dataset, SETTINGS, 0, shape=replace(SHAPE, object_slots=2))
    for step in range(60):
        trainer.step(step, step / 60)
    save_actor(folder / "model.safetensors", trainer.actor(), "chona", {}, {})
    pose, other, camera = dataset.views[0].pose, dataset.views[-1].pose, dataset.views[0].camera
    aside = translation(0.12 * camera.world_from_camera[:3, 0])
    things = np.concatenate([pose.world_from_object, translation(np.array([0.0, 0.0, 0.3])) @ pose.world_from_object])
    first = replace(pose, objects=("box01", "box02"), world_from_object=things)
    second = Pose(other.person, (), aside @ other.world_from_bone, np.zeros((0, 4, 4)))
    return folder / "model.safetensors", camera, first, second


def two_actors(scene: tuple[Path, Camera, Pose, Pose], folder: Path) -> Shot:
    _, camera, first, second = scene
    return read_shot(write_poses(folder / "two.shot.npz", camera, [first], [second]))


def test_names_are_the_actors_and_the_parts(scene, tmp_path: Path) -> None:
    assert matte_names(two_actors(scene, tmp_path)) == ("Sub01.Sub01", "Sub01.box01", "Sub01.box02", "Sub02.Sub02")


def test_all_mattes_together_are_the_picture(scene, tmp_path: Path) -> None:
    """Several objects and two actors that overlap: coverages sum to alpha, and their groups to the plain mattes."""
    shot, actor = two_actors(scene, tmp_path), load_actor(scene[0])
    plain = render_frame(actor, shot, 0, RENDER_PRESETS["preview"])
    layers = render_frame(actor, shot, 0, RENDER_PRESETS["preview"], passes=WITH_MATTES)
    np.testing.assert_array_equal(layers.combined, plain.combined)
    assert layers.cryptomatte is not None
    coverage = layers.cryptomatte.coverage
    np.testing.assert_allclose(coverage.sum(axis=-1), layers.combined[..., 3], atol=2e-5)
    np.testing.assert_allclose(coverage[..., [0, 3]].sum(axis=-1), plain.human, atol=2e-5)
    np.testing.assert_allclose(coverage[..., [1, 2]].sum(axis=-1), plain.object, atol=2e-5)
    mixed = (coverage[..., 0] > 0.05) & (coverage[..., 3] > 0.05)
    assert mixed.sum() > 5 and (coverage.max(axis=(0, 1)) > 0.3).all(), "the test is to show all four, and two at once"


def test_a_matte_is_what_its_actor_shows_alone(scene, tmp_path: Path) -> None:
    """Where nobody else is in front or behind."""
    model, camera, first, second = scene
    actor, settings = load_actor(model), RENDER_PRESETS["preview"]
    layers = render_frame(actor, two_actors(scene, tmp_path), 0, settings, passes=WITH_MATTES)
    alone = [actor.render(pose, camera, settings) for pose in (first, second)]
    apart = (alone[0].alpha > 0) & (alone[1].alpha == 0)
    assert layers.cryptomatte is not None and apart.sum() > 50
    np.testing.assert_allclose(layers.cryptomatte.coverage[apart, 0], alone[0].human[apart], atol=2e-5)
    apart = (alone[1].alpha > 0) & (alone[0].alpha == 0)
    np.testing.assert_allclose(layers.cryptomatte.coverage[apart, 3], alone[1].human[apart], atol=2e-5)


@pytest.mark.parametrize("preset", ["draft", "final"])
def test_one_object_needs_no_samples(scene, preset: str, tmp_path: Path) -> None:
    """With a single object the two plain mattes are the Cryptomatte, at half the resolution as well."""
    model, camera, first, _ = scene
    pose = replace(first, objects=first.objects[:1], world_from_object=first.world_from_object[:1])
    shot = read_shot(write_poses(tmp_path / "one.shot.npz", camera, [pose]))
    layers = render_frame(load_actor(model), shot, 0, RENDER_PRESETS[preset], passes=WITH_MATTES)
    assert layers.cryptomatte is not None and layers.human is not None
    np.testing.assert_array_equal(layers.cryptomatte.coverage, np.stack([layers.human, layers.object], axis=-1))


def baked(folder: Path, model: Path, shot: Path, passes: Passes = WITH_MATTES) -> BakeReport:
    return bake(model, shot, folder / "out", None, "draft", False, Progress(), passes=passes)


def test_a_renamed_actor_is_baked_again(scene, tmp_path: Path) -> None:
    """Its pixels are the same, but not its ids; without a Cryptomatte nothing has changed."""
    model, camera, first, _ = scene
    path = write_poses(tmp_path / "walk.shot.npz", camera, [first])
    assert baked(tmp_path, model, path).written == 1
    assert baked(tmp_path, model, path).skipped == 1
    shot = read_shot(path)
    write_shot(path, replace(shot, actors=(replace(shot.actors[0], name="Hero"),)))
    assert baked(tmp_path, model, path).written == 1
    layers, _ = read_frame(tmp_path / "out" / "walk_0001.exr")
    assert layers.cryptomatte is not None
    assert layers.cryptomatte.names == ("Hero.Sub01", "Hero.box01", "Hero.box02")
    assert baked(tmp_path, model, path, Passes()).written == 1
    write_shot(path, shot)
    assert baked(tmp_path, model, path, Passes()).skipped == 1


def test_frames_that_repeat_are_copied_with_their_mattes(scene, tmp_path: Path) -> None:
    model, camera, first, _ = scene
    path = write_poses(tmp_path / "walk.shot.npz", camera, [first, first])
    report = baked(tmp_path, model, path)
    assert (report.written, report.repeated) == (2, 1)
    one, other = (read_frame(tmp_path / "out" / f"walk_000{number}.exr")[0].cryptomatte for number in (1, 2))
    assert one is not None and other is not None and one.coverage.max() > 0.5
    np.testing.assert_array_equal(one.coverage, other.coverage)
