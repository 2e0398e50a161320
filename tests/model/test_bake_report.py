"""What a bake leaves out, and that it says so: identities, bones at rest, what is out of the picture, passes."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scene_files import PLACES, grid_file, moved, without_objects, write_poses
from scipy.spatial.transform import Rotation
from tiny_capture import SKELETON

from chona_model import shot_models as module
from chona_model.bake import bake
from chona_model.bake_report import BakeReport
from chona_model.camera import ORTHOGRAPHIC
from chona_model.cryptomatte import Mattes
from chona_model.data.dataset import Pose
from chona_model.formats.exr import FrameLayers, read_frame
from chona_model.formats.exr_structure import check_exr
from chona_model.formats.model_file import read_header
from chona_model.formats.shot import ShotError, read_shot
from chona_model.frame import render_frame
from chona_model.grid_actor import GridActor
from chona_model.model_store import load_actor
from chona_model.passes import PASSES, PassError, Passes
from chona_model.progress import Progress
from chona_model.settings import RENDER_PRESETS
from chona_model.sight import Unseen, bones_at_rest, out_of_picture, shown_identities
from chona_model.skeleton import forward_kinematics


def run(folder: Path, shot: Path, **options: object) -> BakeReport:
    return bake(grid_file()[0], shot, folder / "out", None, "draft", False, Progress(), **options)  # type: ignore[arg-type]


def poses_with_the_object_out_in_two_of_three() -> tuple[Pose, ...]:
    _, dataset = grid_file()
    view = dataset.views[0]
    far, beside = (moved(view.pose.world_from_object, view.camera, PLACES[name]) for name in ("behind", "beside"))
    return view.pose, replace(view.pose, world_from_object=far), replace(view.pose, world_from_object=beside)


def test_the_report_says_what_was_left_out(tmp_path: Path) -> None:
    """In JSON and in words: four of five identities, the object in two frames of three, two passes."""
    model, dataset = grid_file()
    shot = write_poses(tmp_path / "walk.shot.npz", dataset.views[0].camera, poses_with_the_object_out_in_two_of_three())
    lines = io.StringIO()
    passes = Passes.of(["combined", "depth"])
    report = bake(model, shot, tmp_path / "out", None, "draft", False, Progress("json", output=lines), passes=passes)
    result = json.loads(lines.getvalue().splitlines()[-1])
    assert (result["event"], result["written"], result["skipped"], result["repeated"]) == ("result", 3, 0, 0)
    left = result["left_out"]
    assert left["identities"] == ["Sub02", "box02", "box03"]
    assert 0.4 < left["bytes_not_read"] / read_header(model).size_bytes < 0.7
    assert left["out_of_picture"] == [{"actor": "Sub01", "name": "box01", "frames": 2}]
    assert (left["passes"], left["bones"], left["model_loaded"]) == (["mattes", "confidence"], 2.0, True)
    words = report.left_out.sentence()
    assert words.startswith("Left out: Sub02, box02, box03 (")
    assert "; box01 of Sub01 in 2 of 3 frames, out of the picture; " in words
    assert words.endswith("; the passes mattes, confidence.")
    assert "\n" not in words


def test_nothing_is_loaded_where_every_frame_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, dataset = grid_file()
    shot = write_poses(tmp_path / "walk.shot.npz", dataset.views[0].camera, [dataset.views[0].pose])
    assert run(tmp_path, shot).left_out.loaded

    def refuse(*_: object) -> None:
        raise AssertionError("the model was loaded")

    monkeypatch.setattr(module, "load_with_report", refuse)
    report = run(tmp_path, shot)
    assert (report.written, report.skipped, report.left_out.loaded) == (0, 1, False)
    assert report.left_out.sentence() == "Left out: the model, as no frame had to be rendered."
    with pytest.raises(AssertionError, match="was loaded"):
        run(tmp_path, shot, passes=Passes(depth=False))


def test_an_unknown_identity_is_said_with_all_that_the_file_holds(tmp_path: Path) -> None:
    _, dataset = grid_file()
    pose = replace(dataset.views[0].pose, person="Robin")
    with pytest.raises(ShotError, match="'Robin', the model has Sub01, Sub02"):
        run(tmp_path, write_poses(tmp_path / "a.shot.npz", dataset.views[0].camera, [pose]))
    pose = replace(dataset.views[0].pose, objects=("table",))
    with pytest.raises(ShotError, match="'table', the model has box01, box02, box03"):
        run(tmp_path, write_poses(tmp_path / "b.shot.npz", dataset.views[0].camera, [pose]))


@pytest.mark.parametrize("kind", ["PERSP", ORTHOGRAPHIC])
def test_what_is_said_to_be_out_of_the_picture_is_in_no_pixel(tmp_path: Path, kind: str) -> None:
    """At places all around the picture's edges; not one that is well outside is missed."""
    model, dataset = grid_file()
    pose, camera = dataset.views[0].pose, dataset.views[0].camera
    if kind == ORTHOGRAPHIC:
        intrinsics = camera.intrinsics.copy()
        intrinsics[:2, :2] /= 2.4
        camera = replace(camera, intrinsics=intrinsics, kind=kind)
    random = np.random.default_rng(0)
    places = [(*(sign * random.uniform(0.3, 1.2) for sign in random.choice([-1, 1], 2)), 2.4) for _ in range(24)]
    poses = [replace(pose, world_from_object=moved(pose.world_from_object, camera, place)) for place in places]
    shot = read_shot(write_poses(tmp_path / "walk.shot.npz", camera, poses))
    header, actor = read_header(model), load_actor(model, persons=["Sub01"], objects=["box01"])
    half = np.array([camera.width, camera.height]) / 2 / camera.intrinsics[0, 0] * (1 if kind == ORTHOGRAPHIC else 2.4)
    said = 0
    for index, place in enumerate(places):
        unseen = Unseen("Sub01", "box01") in out_of_picture(shot, index, [header])
        matte = render_frame(actor, shot, index, RENDER_PRESETS["draft"]).object
        assert matte is not None
        assert not (unseen and matte.max() > 0)
        assert unseen or not (np.abs(place[:2]) > half + 0.35).any()
        said += unseen
    assert 4 <= said <= 20


@pytest.mark.parametrize("place", PLACES)
def test_a_person_out_of_the_picture_is_said(tmp_path: Path, place: str) -> None:
    model, dataset = grid_file()
    pose, camera = dataset.views[0].pose, dataset.views[0].camera
    there = replace(pose, world_from_bone=moved(pose.world_from_bone, camera, PLACES[place]))
    shot = read_shot(write_poses(tmp_path / "walk.shot.npz", camera, [pose, there]))
    assert [out_of_picture(shot, index, [read_header(model)]) for index in (0, 1)] == [[], [Unseen("Sub01", "Sub01")]]


def test_what_a_shot_shows_is_what_its_actors_name(tmp_path: Path) -> None:
    _, dataset = grid_file()
    first, second = dataset.views[0].pose, without_objects(dataset.views[2].pose)
    shot = read_shot(write_poses(tmp_path / "walk.shot.npz", dataset.views[0].camera, [first], [second]))
    assert shown_identities(shot.actors) == (["Sub01", "Sub02"], ["box01"])


def test_bones_at_rest_are_those_that_are_not_blended(tmp_path: Path) -> None:
    model, dataset = grid_file()
    header, actor = read_header(model), load_actor(model, persons=["Sub01"], objects=[])
    assert isinstance(actor, GridActor)
    poses = []
    for moving in (0, 1, 2):  # the head, then the chest with it
        turns = np.zeros((3, 3))
        turns[3 - moving :] = 0.3
        turns[0] = 0.0, 0.0, 1.0
        world = forward_kinematics(
            SKELETON, header.rest_joints("Sub01"), Rotation.from_rotvec(turns).as_matrix(), np.zeros(3)
        )
        poses.append(Pose("Sub01", (), world, np.zeros((0, 4, 4))))
    shot = read_shot(write_poses(tmp_path / "walk.shot.npz", dataset.views[0].camera, poses))
    for moving, pose in enumerate(poses):
        assert bones_at_rest(shot, moving, [header]) == (2 - moving, 2)
        actor.model.rendering_matrices(actor.model.posed(pose))
        assert actor.model.volume(0).blended_bones == moving


# Passes

CHANNELS = {
    "combined": [f"CHONA.Combined.{letter}" for letter in "ABGR"],
    "depth": ["CHONA.Depth.Z"],
    "mattes": ["CHONA.Human.V", "CHONA.Object.V"],
    "confidence": ["CHONA.Confidence.V"],
    "normal": [f"CHONA.Normal.{letter}" for letter in "XYZ"],
    "cryptomatte": [f"CHONA.CryptoActor{level}.{letter}" for level in ("00", "01") for letter in "ABGR"],
}


def test_a_pass_that_is_not_asked_for_is_not_there(tmp_path: Path) -> None:
    """Each alone: the others are neither computed nor written, and what is written is what it is with all."""
    _, dataset = grid_file()
    shot = write_poses(tmp_path / "walk.shot.npz", dataset.views[0].camera, [dataset.views[0].pose])
    path = tmp_path / "out" / "walk_0001.exr"
    run(tmp_path, shot, passes=Passes.of(PASSES))
    whole, _ = read_frame(path)
    size, digest = path.stat().st_size, check_exr(path).text("chona:shot")
    for wanted in ((), *((name,) for name in PASSES[1:])):
        passes = Passes.of(["combined", *wanted])
        assert run(tmp_path, shot, passes=passes).written == 1
        structure = check_exr(path)
        channels = [channel for name in ("combined", *wanted) for channel in CHANNELS[name]]
        assert sorted(structure.channels) == sorted(channels)
        assert structure.text("chona:passes") == ",".join(passes.names)
        assert structure.text("chona:shot") == digest
        assert path.stat().st_size < size
        layers, _ = read_frame(path)
        for name in ("combined", "depth", "human", "object", "confidence", "normal", "cryptomatte"):
            array, same = getattr(layers, name), getattr(whole, name)
            assert (array is None) == (name not in _fields(passes))
            if isinstance(array, Mattes):
                assert array.names == same.names == ("Sub01.Sub01", "Sub01.box01")
                array, same = array.coverage, same.coverage
            if array is not None:
                np.testing.assert_array_equal(array, same)
        report = run(tmp_path, shot, passes=passes)
        assert (report.skipped, report.left_out.passes) == (1, passes.left_out)
    assert run(tmp_path, shot).written == 1


def test_colours_are_linear_premultiplied_and_cut_by_the_clip_range(tmp_path: Path) -> None:
    """The whole picture by the formula; the far half of the figure is cut away."""
    model, dataset = grid_file()
    pose, camera = dataset.views[0].pose, dataset.views[0].camera
    actor = load_actor(model, persons=["Sub01"], objects=["box01"])
    picture = actor.render(pose, camera, RENDER_PRESETS["draft"])
    far = float(np.median(picture.depth[picture.alpha > 0.5]))
    shot = read_shot(write_poses(tmp_path / "walk.shot.npz", camera, [pose]))
    layers = render_frame(actor, replace(shot, clip=np.array([[0.01, far]])), 0, RENDER_PRESETS["draft"])
    kept = picture.depth <= far
    alpha = np.maximum(picture.alpha, 1e-9)[..., None].astype(np.float64)
    straight = np.clip(picture.rgb / alpha, 0.0, 1.0)
    linear = np.where(straight <= 0.04045, straight / 12.92, ((straight + 0.055) / 1.055) ** 2.4)
    expected = np.concatenate([linear * alpha, picture.alpha[..., None]], axis=-1) * kept[..., None]
    np.testing.assert_allclose(layers.combined, expected, atol=1e-6)
    assert 50 < (kept & (picture.alpha > 0.1)).sum() < (picture.alpha > 0.1).sum() - 50


def _fields(passes: Passes) -> set[str]:
    return {field for name in passes.names for field in ({"mattes": ["human", "object"]}.get(name, [name]))}


def test_two_actors_are_layered_alike_without_mattes() -> None:
    actor = load_actor(grid_file()[0])
    with_all, plain = (
        _two(actor, passes) for passes in (Passes(), Passes(depth=False, mattes=False, confidence=False))
    )
    assert plain.human is plain.object is plain.depth is plain.confidence is None
    np.testing.assert_array_equal(plain.combined, with_all.combined)


def _two(actor: object, passes: Passes) -> FrameLayers:
    _, dataset = grid_file()
    first, second = dataset.views[0].pose, without_objects(dataset.views[2].pose)
    folder = Path(dataset.views[0].image).parent
    shot = read_shot(write_poses(folder / "two.shot.npz", dataset.views[0].camera, [first], [second]))
    return render_frame(actor, shot, 0, RENDER_PRESETS["draft"], passes=passes)  # type: ignore[arg-type]


def test_unknown_passes_are_named() -> None:
    with pytest.raises(PassError, match="no pass 'normals'; expected some of combined, depth, mattes, confidence"):
        Passes.of(["depth", "normals"])
    assert Passes.of(["depth"]).names == ("combined", "depth")
