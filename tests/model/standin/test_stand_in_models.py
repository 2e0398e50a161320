"""Stand-ins of small models of both kinds: the renderer's colours, learned weights; files, commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from closed_forms import edges_are_shared, volume
from exact_cases import RIG, SHAPE, small_model
from scipy.spatial.transform import Rotation
from tiny_capture import SKELETON
from tiny_models import trained, unlit

from chona_model.camera import ORTHOGRAPHIC, Camera
from chona_model.cli import main
from chona_model.data.dataset import ObjectShape, Person
from chona_model.exact_actor import ExactActor
from chona_model.figure import Rig
from chona_model.grid_actor import GridActor
from chona_model.model_store import save_actor
from chona_model.progress import Cancel, Cancelled, Progress
from chona_model.render.bounds import BODY_REACH, OBJECT_MARGIN
from chona_model.settings import RENDER_PRESETS
from chona_model.skeleton import SMPL
from chona_model.standin.grid_part import interpolate
from chona_model.standin.make import UPRIGHT, StandInSettings, canonical_pose, make_stand_in, open_parts
from chona_model.standin.surface import LEVEL

VOXEL = 0.03


def saved(path: Path, actor: GridActor | ExactActor) -> Path:
    save_actor(path, actor, "chona", {}, {})
    return path


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of a person of capsules and a box, trained for a few seconds."""
    return saved(tmp_path_factory.mktemp("model") / "model.safetensors", trained()[1].actor())


@pytest.fixture(scope="module")
def made(model: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Header and arrays of its stand-in, by the command."""
    out = model.with_name("stand-in.npz")
    words = ["--model", str(model), "--person", "Sub01", "--objects", "box01", "--voxel", "0.02", "--device", "cpu"]
    assert main(["stand-in", *words, "--out", str(out)]) == 0
    with np.load(out, allow_pickle=False) as content:
        arrays = {name: content[name] for name in content.files}
    return json.loads(arrays.pop("header").tobytes()), arrays


def part(made: tuple[dict, dict[str, np.ndarray]], kind: str) -> dict[str, np.ndarray]:
    """The arrays of one part."""
    index = next(number for number, each in enumerate(made[0]["parts"]) if each["kind"] == kind)
    prefix = f"part.{index}."
    return {name.removeprefix(prefix): array for name, array in made[1].items() if name.startswith(prefix)}


def test_the_file_says_what_it_holds(made, model) -> None:
    header, arrays = made
    assert (header["format"], header["version"], header["voxel"]) == ("chona-stand-in", 1, 0.02)
    assert header["skeleton"] == {"names": list(SKELETON.names), "parents": list(SKELETON.parents)}
    assert [(each["kind"], each["name"]) for each in header["parts"]] == [("person", "Sub01"), ("object", "box01")]
    for index, each in enumerate(header["parts"]):
        assert arrays[f"part.{index}.vertices"].shape == (each["vertices"], 3)
        assert arrays[f"part.{index}.faces"].shape == (each["faces"], 3)
    kinds = {name.rpartition(".")[2]: array.dtype.name for name, array in arrays.items()}
    assert kinds == {"vertices": "float32", "faces": "int32", "normals": "float32", "colours": "uint8",
                     "bones": "int16", "weights": "float32"}  # fmt: skip
    assert "part.1.bones" not in arrays


def test_meshes_are_where_the_captured_forms_are(model) -> None:
    """A box and capsules that a model of 3 cm cells has seen for seconds in 64 x 48 pixels of 2 cm: it is soft, so what
    is compared is where light is stopped, not its outline."""
    out = model.with_name("soft.npz")
    make_stand_in(model, "Sub01", ("box01",), out, StandInSettings(0.02, edge=LEVEL), Progress())
    with np.load(out) as content:
        body, box = ({name: content[f"part.{index}.{name}"] for name in ("vertices", "faces")} for index in range(2))
    for each in (box, body):
        assert edges_are_shared(each["faces"]) and volume(each["vertices"], each["faces"]) > 0
    thing = trained()[0].objects["box01"]
    away = np.maximum(thing.lower - box["vertices"], box["vertices"] - thing.upper).max(axis=1)
    assert np.abs(away).mean() < 0.015 and np.percentile(np.abs(away), 95) < 0.035
    person = trained()[0].persons["Sub01"]
    tails = SKELETON.bone_tails(person.rest_joints)
    heads, along = person.rest_joints, tails - person.rest_joints
    share = np.einsum("vbi,bi->vb", body["vertices"][:, None] - heads, along) / (along**2).sum(axis=1)
    nearest = heads + np.clip(share, 0, 1)[..., None] * along
    away = np.linalg.norm(body["vertices"][:, None] - nearest, axis=2).min(axis=1) - 0.09
    assert np.abs(away).mean() < 0.02 and np.percentile(np.abs(away), 95) < 0.05


def test_colours_are_those_the_renderer_shows(model) -> None:
    """The canonical pose from the front, without the learned light: pixels against the vertices that they show."""
    actor = GridActor(unlit(trained()[1].actor().model))
    path = saved(model.with_name("unlit.safetensors"), actor)
    out = model.with_name("unlit.npz")
    make_stand_in(path, "Sub01", (), out, StandInSettings(0.02, edge=LEVEL), Progress())
    with np.load(out) as content:
        vertices, normals, colours = (content[f"part.0.{name}"] for name in ("vertices", "normals", "colours"))
    rig = Rig(actor.skeleton, actor.persons["Sub01"].rest_joints, actor.object_distance)
    camera_from_front = np.eye(4)
    camera_from_front[:3, :3] = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # looks along +y, up is +z
    camera_from_front[:3, 3] = (0.0, -3.0, 0.3)
    camera = Camera(np.array([[150.0, 0, 60], [0, 150.0, 75], [0, 0, 1]]), camera_from_front, 120, 150, ORTHOGRAPHIC)
    picture = actor.render(canonical_pose(rig, "Sub01", ()), camera, RENDER_PRESETS["exact"])
    world = vertices @ UPRIGHT[:3, :3].T
    pixels, depth = camera.project(world)
    column, row = pixels.astype(int).T
    seen = (normals[:, 2] > 0.9) & (np.abs(picture.depth[row, column] - depth) < 0.02)
    seen &= picture.alpha[row, column] > 0.98
    assert seen.sum() > 100
    error = np.abs(picture.rgb[row, column] - colours / 255.0)[seen]
    assert error.mean() < 0.03 and np.percentile(error, 95) < 0.1


def test_weights_are_the_learned_ones(made, model) -> None:
    body = part(made, "person")
    np.testing.assert_allclose(body["weights"].sum(axis=1), 1.0, rtol=1e-5)
    assert (body["weights"][body["bones"] >= 0] >= 0.01).all()
    volume_of = trained()[1].actor().model.volume(0)
    grid, learned = volume_of.grid, volume_of.weights().detach().numpy()
    # On a node the weights are the node's.
    nodes = np.flatnonzero((grid.points > grid.origin).all(axis=1))[:50]
    np.testing.assert_allclose(interpolate(grid, learned, grid.points[nodes].astype(float)), learned[nodes], atol=1e-4)
    dense = interpolate(grid, learned, body["vertices"].astype(float))
    own = np.zeros_like(dense)
    for bones, weights in zip(body["bones"].T, body["weights"].T, strict=True):
        own[np.flatnonzero(bones >= 0), bones[bones >= 0]] = weights[bones >= 0]
    assert np.abs(own - dense).max() < 0.02  # three bones: only what weighs less than a hundredth is missing


def opaque_exact_model(path: Path) -> Path:
    """A model of the paper's path that is opaque wherever it may be: its shape is its bounds'."""
    model = small_model(dtype=torch.float32)
    torch.nn.init.zeros_(model.field.density_layer.weight)
    torch.nn.init.constant_(model.field.density_layer.bias, 400.0)
    box = np.full(3, 0.2)
    people = {name: Person(name, RIG.rest_joints) for name in ("A", "B")}
    things = {name: ObjectShape(name, -box, box) for name in ("x", "y", "z")}
    return saved(path, ExactActor(model, SMPL, people, things, SHAPE.object_distance))


def test_the_exact_kind_of_model(tmp_path) -> None:
    """Capsules around the bones and a box: within a voxel of where the bounds have them; weights are its network's."""
    path = opaque_exact_model(tmp_path / "model.safetensors")
    out = tmp_path / "out.npz"
    make_stand_in(path, "B", ("y",), out, StandInSettings(VOXEL), Progress())
    with np.load(out) as content:
        arrays = {name: content[name] for name in content.files}
    body, box = arrays["part.0.vertices"].astype(float), arrays["part.1.vertices"].astype(float)
    for index in range(2):
        assert edges_are_shared(arrays[f"part.{index}.faces"])
    tails = SMPL.bone_tails(RIG.rest_joints)
    along = tails - RIG.rest_joints
    share = np.einsum("vbi,bi->vb", body[:, None] - RIG.rest_joints, along) / (along**2).sum(axis=1)
    nearest = RIG.rest_joints + np.clip(share, 0, 1)[..., None] * along
    away = np.linalg.norm(body[:, None] - nearest, axis=2).min(axis=1) - BODY_REACH
    within = ((body > np.array(SHAPE.lower) + VOXEL) & (body < np.array(SHAPE.upper) - VOXEL)).all(axis=1)
    assert within.mean() > 0.6 and np.abs(away[within]).max() < VOXEL
    np.testing.assert_allclose(np.ptp(box, axis=0), 2 * (0.2 + OBJECT_MARGIN), atol=VOXEL)
    np.testing.assert_allclose(box.mean(axis=0), 0.0, atol=0.2 * VOXEL)
    parts, actor = open_parts(path, "B", ("y",), "cpu")
    with torch.no_grad():
        every = actor.model.deform.skinning(torch.as_tensor(body[:50], dtype=torch.float32)).numpy()
    body_only = every[:, : len(SMPL)] / every[:, : len(SMPL)].sum(axis=1, keepdims=True)
    np.testing.assert_allclose(parts[0].weights(body[:50]), body_only, atol=1e-5)
    assert arrays["part.0.bones"][0, 0] == body_only[0].argmax()


def test_faces_are_limited(model, tmp_path) -> None:
    words = ["--model", str(model), "--objects", "box01", "--voxel", "0.02", "--faces", "500", "--device", "cpu"]
    assert main(["stand-in", *words, "--out", str(tmp_path / "a.npz")]) == 0
    with np.load(tmp_path / "a.npz") as content:
        faces = content["part.0.faces"]
    assert 200 < len(faces) <= 500 and edges_are_shared(faces)


def test_a_cancelled_job_leaves_nothing(model, tmp_path) -> None:
    cancel = Cancel()
    cancel.request()
    with pytest.raises(Cancelled):
        make_stand_in(model, "Sub01", (), tmp_path / "a.npz", StandInSettings(0.02), Progress(cancel=cancel))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "neither --person nor --objects is given"),
        (("--person", "Nobody"), "holds no person 'Nobody'; it holds: Sub01"),
        (("--objects", "sofa"), "holds no object 'sofa'; it holds: box01"),
        (("--person", "Sub01", "--voxel", "0"), "expected a number of at least 0.001 and at most 0.2"),
        (("--person", "Sub01", "--voxel", "0.001"), "give a larger --voxel"),
        (("--person", "Sub01", "--faces", "3"), "expected a whole number from 100"),
        (("--person", "Sub01", "--out", "mesh.ply"), "mesh.ply, expected a file NAME.npz"),
    ],
)
def test_wrong_input_is_told(model, tmp_path, capsys, monkeypatch, words, said) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("chona_model.standin.make.MOST_NODES", 10_000_000)
    given = ["stand-in", "--model", str(model), "--device", "cpu", *words]
    assert main(given if "--out" in words else [*given, "--out", "a.npz"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and said in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_the_canonical_pose_stands_upright() -> None:
    rig = Rig(SMPL, RIG.rest_joints, 1.5)
    pose = canonical_pose(rig, "A", ("x",))
    turn = Rotation.from_matrix(pose.world_from_bone[0, :3, :3]).as_rotvec(degrees=True)
    np.testing.assert_allclose(turn, (90.0, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(pose.world_from_bone[5, :3, 3], RIG.rest_joints[5] @ UPRIGHT[:3, :3].T)
