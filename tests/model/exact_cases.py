"""Figures, poses and small models that the tests of the exact path share."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from benchmarks.recovery_cases import REST_JOINTS
from chona_model.deform.skinning import DeformShape
from chona_model.exact import ExactModel
from chona_model.exact_shape import ExactShape
from chona_model.field.radiance import FieldShape
from chona_model.figure import Figure, PoseBatch, RayBatch, Rig, make_figure, to_pose_batch
from chona_model.skeleton import SMPL, forward_kinematics

torch.set_num_threads(1)  # these tensors are so small that threads only wait for each other

BONES = len(SMPL)

OBJECT_DISTANCE = 0.8

RIG = Rig(SMPL, REST_JOINTS, OBJECT_DISTANCE)

SHAPE = ExactShape(
    bones=BONES,
    object_slots=1,
    n_persons=2,
    n_objects=3,
    lower=(-1.1, -1.2, -0.5),
    upper=(1.1, 1.0, 1.3),
    object_distance=OBJECT_DISTANCE,
    code_size=4,
    object_lower=((-0.2, -0.2, -0.2),) * 3,
    object_upper=((0.2, 0.2, 0.2),) * 3,
    deform=DeformShape(degrees=3, width=32, depth=3),
    radiance=FieldShape(degrees=6, width=32, depth=6, head_width=16),
)


def random_figure(angle: float, seed: int, *, with_object: bool = True, shift: tuple[float, ...] = (0, 0, 0)) -> Figure:
    """Joint rotations by up to ``angle`` radians about random axes, an object somewhere near the hands."""
    generator = np.random.default_rng(seed)
    axes = generator.normal(size=(BONES, 3))
    axes *= generator.uniform(0, angle, (BONES, 1)) / np.linalg.norm(axes, axis=1, keepdims=True)
    world = forward_kinematics(SMPL, REST_JOINTS, Rotation.from_rotvec(axes).as_matrix(), np.zeros(3))
    world[:, :3, 3] += shift
    objects = np.zeros((1 if with_object else 0, 4, 4))
    if with_object:
        objects[0] = np.eye(4)
        objects[0, :3, :3] = Rotation.from_rotvec(generator.normal(size=3)).as_matrix()
        objects[0, :3, 3] = np.array([0.1, 0.2, 0.5]) + shift
    return make_figure(RIG, world, objects, 1)


def pose_batch(*figures: Figure, dtype: torch.dtype = torch.float64) -> PoseBatch:
    """The figures as one batch, person 0 with object 0."""
    count = len(figures)
    return to_pose_batch(figures, [RIG] * count, [0] * count, [[0]] * count, dtype)


def small_model(seed: int = 0, dtype: torch.dtype = torch.float64, shape: ExactShape = SHAPE) -> ExactModel:
    """A model of random weights whose offset is large enough to be seen in gradients."""
    torch.manual_seed(seed)
    model = ExactModel(shape)
    output = model.deform.offset.mlp.output
    assert output is not None
    torch.nn.init.uniform_(output.weight, -0.02, 0.02)
    return model.to(dtype)


def frontal_rays(side: int, dtype: torch.dtype = torch.float64, poses: int = 1) -> RayBatch:
    """side² rays from 3 m in front of the figure, looking back at it along -z."""
    places = torch.linspace(-0.35, 0.35, side, dtype=dtype)
    y, x = torch.meshgrid(places, places, indexing="ij")
    directions = torch.stack([x, y, -torch.ones_like(x)], dim=-1).reshape(-1, 3)
    count = len(directions)
    return RayBatch(
        origins=torch.tensor([0.0, -0.1, 3.0], dtype=dtype).expand(count, 3),
        directions=directions,
        radii=torch.full((count,), 2e-3, dtype=dtype),
        near=torch.full((count,), 1.5, dtype=dtype),
        far=torch.full((count,), 4.0, dtype=dtype),
        pose=torch.arange(count) % poses,
    )
