"""The shot: round trip, and every refusal by its message."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from chona_model.formats.shot import Shot, ShotActor, ShotError, read_shot, write_shot

FRAMES = 3


def _rigid(*shape: int) -> np.ndarray:
    return np.broadcast_to(np.eye(4), (*shape, 4, 4)).copy()


@pytest.fixture
def actor() -> ShotActor:
    return ShotActor("Robin", "Sub01", ("crate",), ("pelvis", "spine"), _rigid(FRAMES, 2), _rigid(FRAMES, 1))


@pytest.fixture
def shot(actor: ShotActor) -> Shot:
    intrinsics = np.broadcast_to(np.array([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]]), (FRAMES, 3, 3)).copy()
    clip = np.broadcast_to([0.1, 100.0], (FRAMES, 2)).copy()
    frames = np.array([-1, 4, 5])
    return Shot("walk", 24.0, 64, 48, "PERSP", frames, intrinsics, _rigid(FRAMES), clip, (actor,))


def test_a_shot_comes_back_as_written(tmp_path: Path, shot: Shot) -> None:
    path = tmp_path / "deep" / "walk.shot.npz"
    write_shot(path, shot)
    back = read_shot(path)
    for name in ("name", "fps", "width", "height", "camera_kind"):
        assert getattr(back, name) == getattr(shot, name)
    for name in ("frames", "intrinsics", "world_from_camera", "clip"):
        assert (getattr(back, name) == getattr(shot, name)).all()
    assert back.actors[0].bones == ("pelvis", "spine")
    assert back.actors[0].pose(1).objects == ("crate",)
    assert back.camera(2).width == 64
    assert [entry.name for entry in path.parent.iterdir()] == ["walk.shot.npz"]


def test_a_shot_of_objects_alone_comes_back(tmp_path: Path, shot: Shot, actor: ShotActor) -> None:
    prop = replace(actor, person=None, bones=(), world_from_bone=np.zeros((FRAMES, 0, 4, 4)))
    write_shot(tmp_path / "a.shot.npz", replace(shot, actors=(prop,), camera_kind="ORTHO"))
    back = read_shot(tmp_path / "a.shot.npz")
    assert back.actors[0].person is None
    assert back.camera(0).kind == "ORTHO"


def test_the_file_is_numpy_and_json_alone(tmp_path: Path, shot: Shot) -> None:
    write_shot(tmp_path / "a.shot.npz", shot)
    with np.load(tmp_path / "a.shot.npz", allow_pickle=False) as content:
        header = json.loads(content["header"].tobytes().decode("utf-8"))
        assert content["actor.0.world_from_bone"].shape == (FRAMES, 2, 4, 4)
        assert content["frames"].dtype == np.int64
    assert header["format"] == "chona-shot"
    assert header["actors"][0] == {
        "name": "Robin", "person": "Sub01", "objects": ["crate"], "bones": ["pelvis", "spine"],
    }  # fmt: skip


def _rewritten(path: Path, change: Callable[[dict[str, np.ndarray], dict[str, object]], None]) -> None:
    with np.load(path) as content:
        arrays = dict(content)
    header = json.loads(arrays["header"].tobytes())
    change(arrays, header)
    if "header" in arrays:
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    path.write_bytes(stream.getvalue())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a, h: h.update(version=2), "version 2, this program reads version 1; export it again"),
        (lambda a, h: h.update(format="chona-capture"), "is a 'chona-capture', expected a 'chona-shot'"),
        (lambda a, h: h.update(width="64"), "breaks the format.*width"),
        (lambda a, h: h.update(surprise=1), "breaks the format.*surprise"),
        (lambda a, h: h.pop("fps"), "breaks the format.*fps"),
        (lambda a, h: h.update(camera_kind="PANO"), "breaks the format.*camera_kind"),
        (lambda a, h: h.update(fps=0.0), "fps is 0.0, expected a positive"),
        (lambda a, h: h.update(height=0), "64x0 pixels, expected 1 to"),
        (lambda a, h: h.update(name="../walk"), "'../walk', expected a name that can be part of a file name"),
        (lambda a, h: h.update(actors=[]), "has no actor"),
        (lambda a, h: a.pop("header"), "has no header"),
        (lambda a, h: h["actors"][0].update(model=7), "breaks the format.*model"),
        (lambda a, h: a.pop("camera.clip"), "'camera.clip' is missing"),
        (lambda a, h: a.update(frames=a["frames"].astype(float)), "'frames' has the type float64, expected int64"),
        (lambda a, h: a.update(frames=a["frames"][::-1].copy()), "frames must increase, but 4 follows 5"),
        (lambda a, h: a.update(frames=a["frames"][:0]), "the frame range is empty"),
        (lambda a, h: a.update({"camera.clip": a["camera.clip"][:2]}), r"camera.clip has the shape \(2, 2\), expected"),
        (lambda a, h: a["camera.clip"].__setitem__((1, 0), 200.0), "clip range in frame 4 is 200.0 to 100.0"),
        (lambda a, h: a["camera.clip"].__setitem__((1, 1), 4e38), r"is 0.1 to 4e\+38, expected .* far <= 3.4e\+38"),
        (lambda a, h: a["camera.intrinsics"].__setitem__((2, 0, 0), -1.0), "intrinsics in frame 5 are"),
        (lambda a, h: a["camera.intrinsics"].__setitem__((2, 0, 0), np.nan), "intrinsics in frame 5 are not finite"),
        (lambda a, h: a["camera.world_from_camera"].__setitem__((0, 0, 0), 2), "the camera in frame -1 is scaled"),
        (
            lambda a, h: a["actor.0.world_from_bone"].__setitem__((1, 1, 0, 3), np.inf),
            "bone 'spine' of actor 'Robin' in frame 4 has a matrix that is not finite",
        ),
        (
            lambda a, h: a["actor.0.world_from_bone"].__setitem__((1, 1, 0, 1), 0.2),
            r"bone 'spine' of actor 'Robin' in frame 4 is scaled or sheared \(by 0.2\).*apply its scale in Blender",
        ),
        (
            lambda a, h: a["actor.0.world_from_object"].__setitem__((2, 0, 0, 0), -1.0),
            "object 'crate' of actor 'Robin' in frame 5 is mirrored",
        ),
        (
            lambda a, h: a["actor.0.world_from_bone"].__setitem__((0, 0, 3, 0), 0.5),
            "bone 'pelvis' of actor 'Robin' in frame -1",
        ),
        (lambda a, h: h["actors"][0].update(bones=["pelvis"]), r"world_from_bone of actor 'Robin' has the shape"),
        (lambda a, h: h["actors"][0].update(bones=["a", "a"]), "has a bone name twice"),
        (lambda a, h: h["actors"].append(h["actors"][0]), "'actor.1.world_from_bone' is missing"),
    ],
)
def test_a_broken_shot_is_refused(
    tmp_path: Path, shot: Shot, change: Callable[[dict[str, np.ndarray], dict[str, object]], None], message: str
) -> None:
    path = tmp_path / "walk.shot.npz"
    write_shot(path, shot)
    _rewritten(path, change)
    with pytest.raises(ShotError, match=message) as caught:
        read_shot(path)
    assert "walk.shot.npz" in str(caught.value)


def test_two_actors_of_one_name_are_refused(shot: Shot, actor: ShotActor) -> None:
    with pytest.raises(ShotError, match="two actors are called 'Robin'"):
        replace(shot, actors=(actor, actor))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bones": (), "world_from_bone": np.zeros((FRAMES, 0, 4, 4))}, "person 'Sub01' but has no bones"),
        (
            {"person": None, "bones": (), "objects": (), "world_from_bone": _rigid(FRAMES, 0)},
            "neither bones nor objects",
        ),
    ],
)
def test_an_actor_of_nothing_is_refused(shot: Shot, actor: ShotActor, change: dict[str, object], message: str) -> None:
    with pytest.raises(ShotError, match=message):
        replace(shot, actors=(replace(actor, **change),))  # type: ignore[arg-type]


def test_rigid_matrices_with_rounding_pass_far_from_the_origin(shot: Shot) -> None:
    matrices = _rigid(FRAMES).astype(np.float32)
    matrices[:, :3, 3] = 1e6
    matrices[:, :3, :3] += 2e-5
    assert len(replace(shot, world_from_camera=matrices.astype(np.float64))) == FRAMES


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_truncated_file_is_refused(tmp_path: Path, shot: Shot, share: float) -> None:
    path = tmp_path / "walk.shot.npz"
    write_shot(path, shot)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    with pytest.raises(ShotError, match=r"cannot read the shot .*walk\.shot\.npz"):
        read_shot(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ShotError, match="cannot read the shot"):
        read_shot(tmp_path / "nothing.shot.npz")
