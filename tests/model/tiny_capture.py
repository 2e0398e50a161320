"""A capture small enough for any test: people of three capsules and boxes, drawn by ray casting."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from chona_model.camera import Camera
from chona_model.data.dataset import Dataset, ObjectShape, Person, Pose, View
from chona_model.skeleton import Skeleton, forward_kinematics

SKELETON = Skeleton(("hips", "chest", "head"), (-1, 0, 1))

JOINTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.55, 0.03]])
"""Canonical joints of the first person, metres; those of the others are up to a tenth larger."""

RADIUS = 0.09
"""Of every capsule, metres."""

COLOURS = ((0.85, 0.3, 0.2), (0.25, 0.6, 0.3), (0.9, 0.75, 0.6), (0.2, 0.35, 0.8), (0.8, 0.7, 0.1), (0.5, 0.2, 0.6))

DISTANCE = 2.4
"""Of the cameras to the middle of the scene, metres."""

WORLD_FROM_BODY = Rotation.from_euler("x", 90, degrees=True).as_matrix()
"""The posed world is z up, canonical space is y up."""

CASTS = 192
"""Points tested along each pixel's ray."""


def tiny_capture(
    tmp_path: Path,
    persons: int = 1,
    objects: int = 1,
    frames: int = 2,
    cameras: int = 2,
    size: tuple[int, int] = (32, 24),
) -> Dataset:
    """Writes images and masks into ``tmp_path`` and returns the dataset; the same arguments give the same pixels.

    Sequence ``Date01_Sub01_box01`` shows person ``Sub01`` with object ``box01``; there are as many sequences as the
    larger of ``persons`` and ``objects``, the smaller in turn.  Without persons poses have None, without objects no
    object; every frame has another pose.

    Args:
        frames: a sequence.
        cameras: named ``k0``, ``k1``, …, on a circle around the scene.
        size: width and height in pixels.
    """
    people = {f"Sub{index + 1:02d}": _person(index) for index in range(persons)}
    things = {f"box{index + 1:02d}": _thing(index) for index in range(objects)}
    views = []
    for number in range(max(persons, objects)):
        person = list(people)[number % persons] if persons else None
        thing = list(things)[number % objects] if objects else None
        sequence = "_".join(["Date01", *filter(None, (person, thing))])
        for frame in range(frames):
            pose = tiny_pose(people.get(person or ""), thing, number * frames + frame)
            colours = np.array(
                [COLOURS[(3 * (number % max(persons, 1)) + part) % len(COLOURS)] for part in range(3)]
                + [COLOURS[(4 + number % max(objects, 1)) % len(COLOURS)]]
            )
            for index, camera in enumerate(tiny_cameras(cameras, size)):
                folder = tmp_path / sequence / f"t{frame:04d}.000"
                folder.mkdir(parents=True, exist_ok=True)
                parts = _cast(camera, pose, people.get(person or ""), things.get(thing or ""))
                views.append(_write(folder, f"k{index}", camera, pose=pose, parts=parts, colours=colours))
    return Dataset(SKELETON, people, things, tuple(views))


def tiny_pose(person: Person | None, thing: str | None, number: int) -> Pose:
    """Pose ``number``: bent a little, the object in front of the chest; with a name of an object or None."""
    generator = np.random.default_rng(number)
    bones = np.zeros((0, 4, 4))
    if person is not None:
        turns = generator.normal(scale=0.3, size=(3, 3))
        local = Rotation.from_rotvec(turns).as_matrix()
        local[0] = WORLD_FROM_BODY @ local[0]
        bones = forward_kinematics(SKELETON, person.rest_joints, local, np.array([0.0, 0.0, -0.3]))
    frames = np.zeros((0 if thing is None else 1, 4, 4))
    if thing is not None:
        frames[0] = np.eye(4)
        frames[0, :3, :3] = Rotation.from_rotvec(generator.normal(scale=0.5, size=3)).as_matrix()
        frames[0, :3, 3] = np.array([0.0, -0.4, 0.1]) + generator.normal(scale=0.03, size=3)
    return Pose(None if person is None else person.name, () if thing is None else (thing,), bones, frames)


def tiny_cameras(count: int, size: tuple[int, int] = (32, 24)) -> list[Camera]:
    """Cameras on a circle around the scene, at the height of the chest."""
    width, height = size
    focal = 2.3 * min(width, height)
    intrinsics = np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])
    found = []
    for index in range(count):
        # The first camera stands a little beside the front, so that neither body nor box hides the other.
        angle = 2.0 * np.pi * index / count + 0.9
        forward = np.array([-np.sin(angle), np.cos(angle), 0.0])
        down = np.array([0.0, 0.0, -1.0])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([np.cross(down, forward), down, forward], axis=1)
        pose[:3, 3] = np.array([0.0, -0.15, 0.05]) - DISTANCE * forward
        found.append(Camera(intrinsics, pose, width, height))
    return found


def _person(index: int) -> Person:
    return Person(f"Sub{index + 1:02d}", JOINTS * (1.0 + 0.1 * index / (1.0 + index)))


def _thing(index: int) -> ObjectShape:
    half = np.array([0.12, 0.08, 0.1]) + 0.02 * (index % 3) * np.array([0.0, 1.0, -1.0])
    return ObjectShape(f"box{index + 1:02d}", -half, half)


def _cast(camera: Camera, pose: Pose, person: Person | None, thing: ObjectShape | None) -> np.ndarray:
    """[H, W] what each pixel sees first: capsule 0…2, box 3, nothing -1."""
    origins, directions = camera.rays(camera.pixel_centres())
    depths = np.linspace(DISTANCE - 1.0, DISTANCE + 1.0, CASTS)
    points = origins[..., None, :] + depths[:, None] * directions[..., None, :]
    distances = np.full((*points.shape[:-1], 4), np.inf)
    if person is not None:
        tails = SKELETON.bone_tails(person.rest_joints)
        for bone, frame in enumerate(pose.world_from_bone):
            head, tail = frame[:3, 3], frame[:3, :3] @ (tails[bone] - person.rest_joints[bone]) + frame[:3, 3]
            along = tail - head
            share = np.clip((points - head) @ along / (along @ along), 0.0, 1.0)
            distances[..., bone] = np.linalg.norm(points - head - share[..., None] * along, axis=-1) - RADIUS
    if thing is not None:
        local = (points - pose.world_from_object[0, :3, 3]) @ pose.world_from_object[0, :3, :3]
        distances[..., 3] = np.maximum(thing.lower - local, local - thing.upper).max(axis=-1)
    inside = distances.min(axis=-1) < 0
    first = inside.argmax(axis=-1)
    nearest = np.take_along_axis(distances.argmin(axis=-1), first[..., None], axis=-1)[..., 0]
    return np.where(inside.any(axis=-1), nearest, -1)


def _write(folder: Path, name: str, camera: Camera, *, pose: Pose, parts: np.ndarray, colours: np.ndarray) -> View:
    rgb = np.where(parts[..., None] >= 0, colours[parts], 0.5)
    paths = [folder / f"{name}.{kind}.png" for kind in ("color", "person_mask", "obj_mask")]
    person, thing = (parts >= 0) & (parts < 3), parts == 3
    for path, array in zip(paths, (rgb * 255.0, person * 255, thing * 255), strict=True):
        Image.fromarray(np.round(array).astype(np.uint8)).save(path)
    return View(
        sequence=folder.parent.name, frame=folder.name, camera_name=name, camera=camera, pose=pose, image=paths[0],
        person_mask=paths[1] if pose.person is not None else None, object_mask=paths[2] if pose.objects else None,
    )  # fmt: skip
