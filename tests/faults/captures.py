"""The smallest captures of every layout, file by file, with what spoils each file."""

from __future__ import annotations

import gzip
import io
import json
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from mutations import npy_bytes, packed, spoiled_bytes, spoiled_json, spoiled_npz, spoiled_pickle
from PIL import Image

from chona_model.skeleton import SMPL, SMPL_PARENTS

WIDTH, HEIGHT = 16, 12
FOCAL = 30.0
Spoils = Mapping[str, st.SearchStrategy[bytes]]


def png(mode: str = "RGB", colour: Any = (200, 100, 50), size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    """A picture of one colour."""
    stream = io.BytesIO()
    Image.new(mode, size, colour).save(stream, "PNG")
    return stream.getvalue()


MASK, NO_MASK = png("L", 255), png("L", 0)


def write(root: Path, files: Mapping[str, bytes]) -> None:
    """Files by their path below ``root``."""
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def _text(content: Any) -> bytes:
    return json.dumps(content).encode()


def body_model() -> dict[str, np.ndarray]:
    """SMPL's joints, each a triangle of its own."""
    corners = np.random.default_rng(3).normal(size=(24, 3, 3)) * 0.3
    weights = np.repeat(np.eye(24), 3, axis=0)
    return {
        "v_template": corners.reshape(-1, 3), "f": np.arange(72).reshape(24, 3), "J_regressor": weights.T / 3,
        "weights": weights, "shapedirs": np.zeros((72, 3, 2)),
        "kintree_table": np.stack([np.array(SMPL_PARENTS), np.arange(len(SMPL))]),
    }  # fmt: skip


def behave(root: Path, mark: str) -> Spoils:
    """One sequence of one frame and one Kinect."""
    sequence = "sequences/Date01_Sub01_crate_lift"
    frame = f"{sequence}/t0003.000"
    info = {"config": "../../calibs/Date01/config", "intrinsic": "../../calibs/intrinsics", "cat": "crate",
            "gender": "male", "kinects": [0]}  # fmt: skip
    colour = {"color": {"fx": FOCAL, "fy": FOCAL, "cx": 7.5, "cy": 5.5, "width": WIDTH, "height": HEIGHT,
                        "opencv": [FOCAL, FOCAL, 7.5, 5.5, *[0.0] * 8]}}  # fmt: skip
    pose = {"rotation": np.eye(3).reshape(-1).tolist(), "translation": [0.0, 0.0, 0.0]}
    person = {"pose": np.zeros(156), "betas": np.zeros(2), "trans": np.array([0.0, 0.0, 2.0])}
    thing = {"angle": np.array([0.0, 1.0, 0.0]), "trans": np.array([0.1, 0.2, 2.5])}
    header = b"ply\nformat ascii 1.0\nelement vertex 3\n" + b"".join(b"property float %c\n" % axis for axis in b"xyz")
    ply = header + b"end_header\n0 0 0\n1 0 0\n0 1 1\n"
    binary = header.replace(b"ascii", b"binary_little_endian") + b"end_header\n" + np.eye(3, dtype="<f4").tobytes()
    write(root, {
        f"{sequence}/info.json": _text(info), "calibs/intrinsics/0/calibration.json": _text(colour),
        "calibs/Date01/config/0/config.json": _text(pose), "objects/crate/crate_f1000.ply": ply,
        f"{frame}/person/fit02/person_fit.pkl": pickle.dumps(person),
        f"{frame}/crate/fit01/crate_fit.pkl": pickle.dumps(thing), f"{frame}/k0.color.png": png(),
        f"{frame}/k0.person_mask.png": MASK, f"{frame}/k0.obj_mask.png": NO_MASK,
        "smplh/SMPL_male.npz": packed({name: npy_bytes(array) for name, array in body_model().items()}),
    })  # fmt: skip
    return {
        f"{sequence}/info.json": spoiled_json(info), "calibs/intrinsics/0/calibration.json": spoiled_json(colour),
        "calibs/Date01/config/0/config.json": spoiled_json(pose),
        "objects/crate/crate_f1000.ply": spoiled_bytes(ply) | spoiled_bytes(binary),
        f"{frame}/person/fit02/person_fit.pkl": spoiled_pickle(person, mark),
        f"{frame}/crate/fit01/crate_fit.pkl": spoiled_pickle(thing, mark),
        f"{frame}/k0.color.png": spoiled_bytes(png()), "smplh/SMPL_male.npz": spoiled_npz(body_model()),
    }  # fmt: skip


def _object_npy(content: Any) -> bytes:
    holder = np.empty((), dtype=object)
    holder[()] = content
    return npy_bytes(holder)


def zju_mocap(root: Path, mark: str) -> Spoils:
    """One subject, one frame, one camera."""
    intrinsics = np.array([[FOCAL, 0.0, 7.5], [0.0, FOCAL, 5.5], [0.0, 0.0, 1.0]])
    cams = {"K": [intrinsics], "D": [np.zeros((5, 1))], "R": [np.eye(3)], "T": [np.array([[0.0], [0.0], [3000.0]])]}
    lists = {name: [array.tolist() for array in arrays] for name, arrays in cams.items()}
    images = [{"ims": ["Camera_B1/000000.jpg"]}]
    fit = {"poses": np.zeros((1, 72), np.float32), "shapes": np.zeros((1, 10)), "Rh": np.zeros((1, 3)),
           "Th": np.array([[0.1, 0.2, 0.3]])}  # fmt: skip
    stream = io.BytesIO()
    Image.new("RGB", (WIDTH, HEIGHT), (9, 8, 7)).save(stream, "JPEG")
    write(root, {
        "annots.npy": _object_npy({"cams": cams, "ims": images}), "new_params/0.npy": _object_npy(fit),
        "Camera_B1/000000.jpg": stream.getvalue(), "mask_cihp/Camera_B1/000000.png": MASK,
        "smpl/SMPL_NEUTRAL.npz": packed({name: npy_bytes(array) for name, array in body_model().items()}),
    })  # fmt: skip
    return {
        "annots.npy": spoiled_pickle({"cams": lists, "ims": images}, mark, npy_of_object=True),
        "new_params/0.npy": spoiled_pickle(fit, mark, npy_of_object=True),
        "Camera_B1/000000.jpg": spoiled_bytes(stream.getvalue()),
        "mask_cihp/Camera_B1/000000.png": spoiled_bytes(MASK),
    }


def _ring(count: int) -> list[np.ndarray]:
    """Rigid camera-to-world matrices (OpenGL axes) that look at the origin from 3 m."""
    found = []
    for angle in np.arange(count) * 2.0 * np.pi / count:
        back = np.array([np.cos(angle), np.sin(angle), 0.3])
        back /= np.linalg.norm(back)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
        matrix[:3, 3] = 3.0 * back
        found.append(matrix)
    return found


def _disc() -> np.ndarray:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return ((rows + 0.5 - HEIGHT / 2) ** 2 + (columns + 0.5 - WIDTH / 2) ** 2 < 20).astype(np.uint8) * 255


def transforms(root: Path, _mark: str) -> Spoils:
    """A scan of four pictures with alpha."""
    stream = io.BytesIO()
    Image.fromarray(np.dstack([np.full((HEIGHT, WIDTH, 3), 99, np.uint8), _disc()])).save(stream, "PNG")
    names = [f"images/{index}.png" for index in range(4)]
    frames = [{"file_path": name, "transform_matrix": m.tolist()} for name, m in zip(names, _ring(4), strict=True)]
    content = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": 8.0, "cy": 6.0, "w": WIDTH, "h": HEIGHT, "k1": 0.0, "frames": frames}
    bare = {"camera_angle_x": 0.5, "frames": [{**each, "mask_path": each["file_path"]} for each in frames]}
    write(root, {"transforms.json": _text(content), **dict.fromkeys(names, stream.getvalue())})
    return {
        "transforms.json": spoiled_json(content) | spoiled_json(bare), names[0]: spoiled_bytes(stream.getvalue())
    }  # fmt: skip


def _gz(text: bytes) -> bytes:
    return gzip.compress(text, compresslevel=1)


def co3d(root: Path, _mark: str) -> Spoils:
    """A category of one sequence and four frames."""
    stream = io.BytesIO()
    Image.fromarray(_disc()).save(stream, "PNG")
    frames, files = [], {}
    for index, matrix in enumerate(_ring(4)):
        image, mask = (f"ball/1_2_3/{kind}/{index}.png" for kind in ("images", "masks"))
        files |= {image: png(), mask: stream.getvalue()}
        rotation = matrix[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
        view = {"R": rotation.tolist(), "T": (-matrix[:3, 3] @ rotation).tolist(), "focal_length": [5.0, 5.0],
                "principal_point": [0.0, 0.0], "intrinsics_format": "ndc_isotropic"}  # fmt: skip
        frames.append({"sequence_name": "1_2_3", "frame_number": index,
                       "image": {"path": image, "size": [HEIGHT, WIDTH]},
                       "mask": {"path": mask}, "viewpoint": view})  # fmt: skip
    sequences = [{"sequence_name": "1_2_3", "category": "ball", "viewpoint_quality_score": 1.5,
                  "point_cloud": {"path": "ball/1_2_3/pointcloud.ply"}}]  # fmt: skip
    ply = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    ply += b"-1 -1 -1\n1 1 1\n"
    annotations, listed = "ball/frame_annotations.jgz", "ball/sequence_annotations.jgz"
    write(root, files | {annotations: _gz(_text(frames)), listed: _gz(_text(sequences)),
                         "ball/1_2_3/pointcloud.ply": ply})  # fmt: skip
    return {
        annotations: spoiled_json(frames).map(_gz) | spoiled_bytes(_gz(_text(frames))),
        listed: spoiled_json(sequences).map(_gz), "ball/1_2_3/pointcloud.ply": spoiled_bytes(ply),
    }  # fmt: skip


def blender(root: Path, _mark: str) -> Spoils:
    """A captured scene of one frame and one camera."""

    def still(*shape: int) -> np.ndarray:
        return np.broadcast_to(np.eye(4), (*shape, 4, 4)).copy()

    content = {
        "format": "chona-capture", "version": 1, "skeleton": {"names": ["hips", "head"], "parents": [-1, 0]},
        "persons": {"Sub01": {"rest_joints": [[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]]}},
        "objects": {"box01": {"lower": [-0.1, -0.1, -0.1], "upper": [0.1, 0.1, 0.1]}},
        "sequences": [{"name": "lift", "person": "Sub01", "objects": ["box01"], "cameras": ["k0"], "width": WIDTH,
                       "height": HEIGHT}],
    }  # fmt: skip
    poses = {
        "frames": np.array([1]), "world_from_bone": still(1, 2), "world_from_object": still(1, 1),
        "intrinsics": np.array([[[[FOCAL, 0, 8], [0, FOCAL, 6], [0, 0, 1.0]]]]), "world_from_camera": still(1, 1),
    }  # fmt: skip
    surface = {"vertices": np.eye(3), "weights": np.full((3, 2), 0.5), "faces": np.array([[0, 1, 2]])}
    write(root, {
        "capture.json": _text(content), "sequences/lift/0001/k0.color.png": png(),
        "sequences/lift/poses.npz": packed({name: npy_bytes(array) for name, array in poses.items()}),
        "sequences/lift/0001/k0.person_mask.png": MASK, "sequences/lift/0001/k0.object_mask.png": NO_MASK,
        "persons/Sub01.npz": packed({name: npy_bytes(array) for name, array in surface.items()}),
    })  # fmt: skip
    return {
        "capture.json": spoiled_json(content),
        "sequences/lift/poses.npz": spoiled_npz(poses),
        "persons/Sub01.npz": spoiled_npz(surface),
        "sequences/lift/0001/k0.color.png": spoiled_bytes(png()),
    }


LAYOUTS = {"behave": behave, "zju_mocap": zju_mocap, "transforms": transforms, "co3d": co3d, "blender": blender}
