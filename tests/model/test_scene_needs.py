"""Only what a scene requires, by counting: what is read of a model file, how many rays and evaluations a view takes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
import torch
from exact_cases import OBJECT_DISTANCE, REST_JOINTS, small_model
from safetensors.torch import load_file
from scene_files import NO_BONES, NO_OBJECTS, PLACES, grid_file, moved, without_objects, without_person
from scipy.spatial.transform import Rotation

from chona_model import grid_view
from chona_model.actor import Actor
from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.data.dataset import ObjectShape, Person, Pose
from chona_model.exact_actor import ExactActor
from chona_model.field.present import linear_of_present
from chona_model.formats.model_file import ModelFileError
from chona_model.grid_actor import GridActor
from chona_model.model_store import LoadReport, load_actor, load_with_report, save_actor
from chona_model.render.posed import window_of
from chona_model.settings import RENDER_PRESETS, RenderSettings
from chona_model.skeleton import SMPL, forward_kinematics, translation

CHANNELS = ("rgb", "alpha", "depth", "human", "object", "confidence")


@cache
def exact_file() -> Path:
    """A model of the paper's networks, untrained, of P0, P1, o0, o1 and o2."""
    persons = {f"P{index}": Person(f"P{index}", REST_JOINTS * (1.0 + 0.05 * index)) for index in range(2)}
    objects = {f"o{index}": ObjectShape(f"o{index}", np.full(3, -0.2), np.full(3, 0.2)) for index in range(3)}
    actor = ExactActor(small_model(dtype=torch.float32), SMPL, persons, objects, OBJECT_DISTANCE)
    path = Path(mkdtemp()) / "model.safetensors"
    save_actor(path, actor, "chona", {}, {})
    return path


def cast_of(pose: Pose, path: Path) -> tuple[Actor, LoadReport]:
    """The actor loaded with what a pose shows."""
    return load_with_report(path, persons=[pose.person] if pose.person else [], objects=pose.objects)


# Loading


def test_tensors_of_other_identities_are_not_read() -> None:
    path, _ = grid_file()
    _, report = load_with_report(path, persons=["Sub02"], objects=["box03"])
    assert report.left == ("Sub01", "box01", "box02")
    assert not [name for name in report.read if "Sub01" in name or "box01" in name or "box02" in name]
    sizes = {name: tensor.numel() * tensor.element_size() for name, tensor in load_file(path).items()}
    assert report.read["codes.persons"] == sizes["codes.persons"] / 2
    assert report.read["codes.objects"] == sizes["codes.objects"] / 3
    whole = {name: size for name, size in report.read.items() if not name.startswith("codes.")}
    assert whole == {name: sizes[name] for name in whole}
    others = sum(sizes[name] for name in sizes if name not in report.read)
    assert report.bytes_left == others + sizes["codes.persons"] / 2 + sizes["codes.objects"] * 2 / 3
    assert load_with_report(path)[1].bytes_left == 0


def test_a_person_alone_reads_nothing_of_objects_and_has_no_pseudo_bone() -> None:
    path, dataset = grid_file()
    pose = without_objects(dataset.views[0].pose)
    actor, report = cast_of(pose, path)
    assert isinstance(actor, GridActor)
    assert not [name for name in report.read if "object" in name]
    bones = len(actor.skeleton)
    assert report.read["field.pose_in.weight"] == actor.model.field.shape.pose * 6 * bones * 4
    assert report.read["person.Sub01.skin.offset_mix.0.weight"] == 32 * 6 * bones * 4
    posed = actor.model.posed(pose)
    assert (len(posed.figure.transforms), len(posed.slots), len(posed.code)) == (bones, 0, 6 * bones)
    ready = actor.ready(pose, RENDER_PRESETS["final"])
    assert isinstance(ready, grid_view.ReadyPose)
    assert len(ready.parts.slot_part) == len(ready.parts.slot_matrix) == 0
    assert len(actor.model.occupancy.dims) == len(actor.model.field.table) == 1
    whole = load_actor(path)
    assert isinstance(whole, GridActor)
    assert len(whole.ready(pose, RENDER_PRESETS["final"]).parts.slot_part) == 0  # type: ignore[union-attr]


@pytest.mark.parametrize("shown", ["both", "person", "object"])
@pytest.mark.parametrize("view", [0, 3])
def test_pictures_of_a_part_of_the_model_are_those_of_the_whole(view: int, shown: str) -> None:
    """To the bit: the first person with the first object, the second with the second, and each alone."""
    path, dataset = grid_file()
    pose, camera = dataset.views[view].pose, dataset.views[view].camera
    pose = {"both": pose, "person": without_objects(pose), "object": without_person(pose)}[shown]
    part, report = cast_of(pose, path)
    assert len(report.left) == 3 + (shown != "both")
    whole, alone = (actor.render(pose, camera, RENDER_PRESETS["final"]) for actor in (load_actor(path), part))
    for name in CHANNELS:
        np.testing.assert_array_equal(getattr(alone, name), getattr(whole, name))
    assert whole.alpha.max() > 0.5


def test_a_part_of_a_model_saved_again_is_the_same(tmp_path: Path) -> None:
    """Tables are laid out over the largest box of all that were trained together, even when that is gone."""
    path, dataset = grid_file()
    pose, camera = without_person(dataset.views[0].pose), dataset.views[0].camera
    part, _ = cast_of(pose, path)
    save_actor(tmp_path / "part.safetensors", part, "chona", {}, {})
    again = load_actor(tmp_path / "part.safetensors")
    pictures = [actor.render(pose, camera, RENDER_PRESETS["final"]) for actor in (part, again)]
    np.testing.assert_array_equal(pictures[0].rgb, pictures[1].rgb)


def test_columns_of_what_is_absent_change_no_bit() -> None:
    """With as many bones as a body has the order of summation shows, were the zeros of a code summed too."""
    generator, plain = torch.manual_seed(0), 0
    with torch.no_grad():
        for _ in range(20):
            whole, cut = torch.nn.Linear(153, 32), torch.nn.Linear(144, 32)
            cut.weight.copy_(whole.weight[:, :144])
            cut.bias.copy_(whole.bias)
            code = torch.randn(1, 153, generator=generator)
            code[:, 144:] = 0.0
            assert torch.equal(linear_of_present(whole, code), linear_of_present(cut, code[:, :144]))
            torch.testing.assert_close(linear_of_present(whole, code), whole(code), atol=1e-6, rtol=1e-5)
            plain += torch.equal(whole(code), cut(code[:, :144]))
    assert plain < 20


@pytest.mark.parametrize("shown", ["both", "person", "object"])
def test_the_papers_networks_with_some_codes(shown: str) -> None:
    """Codes by rows; without objects the pseudo bones' weights too are left, which sums in another order."""
    path, world = exact_file(), figure()
    thing = translation(np.array([0.1, 0.2, 0.5]))[None]
    pose = {"both": Pose("P1", ("o2",), world, thing), "person": Pose("P1", (), world, NO_OBJECTS),
            "object": Pose(None, ("o1",), NO_BONES, thing)}[shown]  # fmt: skip
    part, report = cast_of(pose, path)
    assert isinstance(part, ExactActor)
    code = part.model.shape.code_size * 4
    assert report.read["codes.persons"] == code * (shown != "object")
    assert report.read["codes.objects"] == code * (shown != "person")
    assert part.model.shape.object_slots == len(part.objects) == (shown != "person")
    whole, alone = (actor.render(pose, in_front(), RENDER_PRESETS["draft"]) for actor in (load_actor(path), part))
    assert whole.alpha.max() > 0.05
    assert whole.rays == alone.rays > 0
    for name in CHANNELS:
        limit = 2e-6 if shown == "person" else 0.0
        np.testing.assert_allclose(getattr(alone, name), getattr(whole, name), rtol=limit, atol=limit)


def figure() -> np.ndarray:
    turns = 0.3 * np.random.default_rng(0).normal(size=(len(SMPL), 3))
    return forward_kinematics(SMPL, REST_JOINTS * 1.05, Rotation.from_rotvec(turns).as_matrix(), np.zeros(3))


def in_front() -> Camera:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = 0.0, 0.0, 3.0
    return Camera(np.array([[15.0, 0.0, 8.0], [0.0, 15.0, 8.0], [0.0, 0.0, 1.0]]), pose, 16, 16)


@pytest.mark.parametrize(("wanted", "words"), [
    ({"persons": ["Robin"]}, "no person 'Robin'; it holds: Sub01, Sub02"),
    ({"objects": ["box01", "table"]}, "no object 'table'; it holds: box01, box02, box03"),
    ({"persons": [], "objects": []}, "Sub01, Sub02 and the objects box01, box02, box03"),
])  # fmt: skip
def test_what_the_file_lacks_is_said_with_all_it_holds(wanted: dict[str, list[str]], words: str) -> None:
    with pytest.raises(ModelFileError, match=words):
        load_actor(grid_file()[0], **wanted)


# Out of the picture

EVERYTHING = replace(RENDER_PRESETS["final"], stop=0.0, offset=False, supersampling=1)
"""Every sample that could hold something is evaluated, whatever a code or an object's pose does to those before it."""


def count(actor: GridActor, pose: Pose, camera: Camera, settings: RenderSettings = EVERYTHING) -> tuple[int, int, int]:
    """Rays, evaluations of the field and inversions that a view takes."""
    ready = actor.ready(pose, settings)
    assert isinstance(ready, grid_view.ReadyPose)
    window = window_of(ready.part, ready.figure.figure, camera)
    if window.pixels == 0:
        return 0, 0, 0
    view = grid_view.render_view(actor.model, ready, camera, settings, window)
    return len(view.rows), view.evaluated, int(view.values[:, 7].sum())


@pytest.fixture(scope="module")
def scene() -> tuple[GridActor, Pose, Camera]:
    path, dataset = grid_file()
    actor = load_actor(path, persons=["Sub01"], objects=["box01"])
    assert isinstance(actor, GridActor)
    return actor, dataset.views[0].pose, dataset.views[0].camera


@pytest.mark.parametrize("kind", ["PERSP", ORTHOGRAPHIC])
@pytest.mark.parametrize("place", PLACES)
def test_an_object_out_of_the_picture_costs_nothing(
    scene: tuple[GridActor, Pose, Camera], place: str, kind: str
) -> None:
    actor, pose, camera = scene
    camera = as_kind(camera, kind)
    there = replace(pose, world_from_object=moved(pose.world_from_object, camera, PLACES[place]))
    alone = count(actor, without_objects(pose), camera)
    assert count(actor, there, camera) == alone
    assert count(actor, pose, camera)[1] > alone[1] > 1000


@pytest.mark.parametrize("kind", ["PERSP", ORTHOGRAPHIC])
@pytest.mark.parametrize("place", PLACES)
def test_a_person_out_of_the_picture_costs_nothing(
    scene: tuple[GridActor, Pose, Camera], place: str, kind: str
) -> None:
    """No bone is inverted; rays and evaluations are the object's own, but for rounding in another root space."""
    actor, pose, camera = scene
    camera = as_kind(camera, kind)
    there = replace(pose, world_from_bone=moved(pose.world_from_bone, camera, PLACES[place]))
    rays, evaluated, inverted = count(actor, there, camera)
    alone = count(actor, without_person(pose), camera)
    assert inverted == alone[2] == 0
    assert rays == pytest.approx(alone[0], rel=0.02)
    assert evaluated == pytest.approx(alone[1], rel=0.02)
    assert alone[1] > 1000
    assert count(actor, pose, camera)[2] > 1000


def as_kind(camera: Camera, kind: str) -> Camera:
    """The camera, or one without perspective that sees about the same."""
    if kind != ORTHOGRAPHIC:
        return camera
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, :2] /= 2.4
    return replace(camera, intrinsics=intrinsics, kind=kind)


@pytest.mark.parametrize("place", ["right", "beside"])
def test_the_papers_path_traces_no_ray_for_what_is_out_of_the_picture(place: str) -> None:
    actor, camera = load_actor(exact_file()), in_front()
    thing = moved(np.eye(4)[None], camera, PLACES[place])
    both, alone = Pose("P1", ("o2",), figure(), thing), Pose("P1", (), figure(), NO_OBJECTS)
    rays = [actor.render(pose, camera, RENDER_PRESETS["draft"]).rays for pose in (both, alone)]
    assert rays[0] == rays[1] > 0


# Bones at rest


def test_bones_at_rest_are_folded() -> None:
    """An upper body that moves on legs at rest: fewer bones are blended, the matrices are the same."""
    actor = load_actor(grid_file()[0], persons=["Sub01"], objects=[])
    assert isinstance(actor, GridActor)
    model = actor.model
    volume, rest = model.volume(0), model.persons[0].rest_joints
    turns = np.zeros((3, 3))
    turns[2] = 0.0, 0.4, 0.9
    world = forward_kinematics(model.skeleton, rest, Rotation.from_rotvec(turns).as_matrix(), np.array([3.0, 1.0, 0.2]))
    for bones, blended in ((world, 1), (world.astype(np.float32).astype(np.float64), 1), (full(world), 2)):
        posed = model.posed(Pose("Sub01", (), bones, NO_OBJECTS))
        with torch.no_grad():
            plain = model.matrices([posed])[0]
            folded = model.rendering_matrices(posed)
        assert (folded - plain).abs().max() < 1e-6
        assert volume.blended_bones == blended
    still = model.posed(Pose("Sub01", (), np.stack([translation(joint) for joint in rest]), NO_OBJECTS))
    identity = torch.eye(4).reshape(1, 16).expand(len(volume.logits), 16)
    torch.testing.assert_close(model.rendering_matrices(still, offset=False), identity, atol=0.0, rtol=0.0)
    assert volume.blended_bones == 0


def full(world: np.ndarray) -> np.ndarray:
    """The same with the root turned, and the chest with it only in part."""
    turned = world.copy()
    turned[0, :3, :3] = Rotation.from_rotvec([0.0, 0.1, 0.0]).as_matrix() @ turned[0, :3, :3]
    return turned


def test_weights_that_were_trained_on_are_blended_anew() -> None:
    path, dataset = grid_file()
    actor = load_actor(path, persons=["Sub01"], objects=[])
    assert isinstance(actor, GridActor)
    posed = actor.model.posed(without_objects(dataset.views[0].pose))
    actor.model.rendering_matrices(posed, offset=False)
    volume = actor.model.volume(0)
    with torch.no_grad():
        volume.logits.add_(torch.randn(volume.logits.shape, generator=torch.manual_seed(0)))
        volume.rendering_weights = None
        plain = actor.model.matrices([posed], offset=False)[0]
    assert (actor.model.rendering_matrices(posed, offset=False) - plain).abs().max() < 1e-6
