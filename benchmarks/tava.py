"""TAVA's own code, imported from a checkout, handed a real view of a capture.

Last measured with commit a957680 (14 September 2022).  Nothing of TAVA is installed or copied: ``tava.models`` and
``tava.utils`` are imported from the checkout, which needs no package that this project has not; its data loaders and
engines (OpenCV, hydra, tensorboard, CUDA) are not imported.

The model is TAVA's configuration ``mipnerf_dyn`` with ``dataset=zju pos_enc=snarf``, ``loss_bone_w_mult=1`` and
``loss_bone_offset_mult=0.1``, its "full model": 64 samples on each of two levels, K = 5 starts and the background's, at
most 50 Broyden steps, offset network, implicit ambient occlusion.  Weights are random, as no weights for people are
published; ``counted`` says how many of its roots converge and reach the field.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from chona_model.data.dataset import Dataset, View
from chona_model.data.images import load_pixels
from chona_model.skeleton import Skeleton, canonical_to_world, translation

DISTANCE = 0.3
"""TAVA's ``cano_dist`` and ``world_dist`` for people (configs/dataset/zju.yaml), metres."""

CHUNK = 512
"""TAVA's ``test_chunk`` (configs/_basic.yaml), rays."""

LEARNING_RATE = 0.0005
"""TAVA's ``lr_init``; its first step is taken at a hundredth of it (``lr_delay_mult``)."""

COARSE, BONE_WEIGHTS, BONE_OFFSET = 0.1, 1.0, 0.1
"""Multipliers of TAVA's losses (configs/mipnerf_dyn.yaml and docs/experiment.md)."""

MODULES = {
    "mipnerf_dyn": "models", "deform_posi_enc.snarf": "models", "basic.posi_enc": "models", "structures": "utils",
    "camera": "utils",
}  # fmt: skip


class Checkout(SimpleNamespace):
    """TAVA's modules by their last name, ``sources`` (their SHA-256) and ``path``."""


def import_tava(path: Path) -> Checkout:
    """TAVA's modules from a checkout and from nowhere else.

    Raises:
        SystemExit: no checkout, or one that imports something this project has not.
    """
    root = path.resolve() / "tava"
    if not (root / "models" / "mipnerf_dyn.py").is_file():
        raise SystemExit(f"{path} is no checkout of TAVA: there is no tava/models/mipnerf_dyn.py in it")
    # TAVA is a namespace package, which any module of that name on sys.path would hide, this one for a start.
    package = ModuleType("tava")
    package.__path__ = [str(root)]
    sys.modules["tava"] = package
    try:
        found = {name: importlib.import_module(f"tava.{folder}.{name}") for name, folder in MODULES.items()}
    except ImportError as error:
        raise SystemExit(f"{path} does not import ({error}); this was written for commit a957680") from error
    digest = hashlib.sha256()
    for file in sorted(file for folder in ("models", "utils") for file in (root / folder).rglob("*.py")):
        digest.update(file.read_bytes())
    modules = {name.rpartition(".")[2]: module for name, module in found.items()}
    return Checkout(**modules, sources=digest.hexdigest(), path=str(path))


def bone_ends(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Joints at the head and at the tail of every bone as TAVA counts them, from parent to child: [B − 1] each."""
    tails = np.arange(1, len(skeleton))
    return np.array(skeleton.parents)[tails], tails


def rigid_clusters(skeleton: Skeleton) -> np.ndarray:
    """[B − 1] which transform each bone moves with: bones of one parent share its (19 transforms of SMPL's 23)."""
    return np.unique(bone_ends(skeleton)[0], return_inverse=True)[1]


def pose_latent(skeleton: Skeleton, rest_joints: np.ndarray, world_from_bone: np.ndarray) -> np.ndarray:
    """The pose as TAVA's people have it, [3 B + 6]: axis-angles to the parent with the root's left zero, then the
    root's rotation (axis-angle) and the translation that follows it, metres."""
    rotations = world_from_bone[:, :3, :3]
    heads, tails = bone_ends(skeleton)
    local = Rotation.from_matrix(np.swapaxes(rotations[heads], -1, -2) @ rotations[tails]).as_rotvec()
    root = canonical_to_world(world_from_bone, rest_joints)[0]
    return np.concatenate([np.zeros(3), local.ravel(), Rotation.from_matrix(root[:3, :3]).as_rotvec(), root[:3, 3]])


def real(array: np.ndarray) -> Tensor:
    """As float32, TAVA's precision."""
    return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32)


@dataclass(frozen=True)
class Shot:
    """One view's rays that hit the figure, as TAVA takes them.

    Attributes:
        rays: TAVA's ``Rays`` of R pixels; colours: [R, 3] what the picture shows there.
        frame: the keyword arguments of its model that belong to the pose and the background.
        pixels: [R, 2] rows and columns.
    """

    rays: Any
    colours: Tensor
    frame: dict[str, Any]
    pixels: np.ndarray

    def part(self, tava: Checkout, begin: int, end: int) -> Shot:
        """Some of the rays."""
        rays = tava.structures.namedtuple_map(lambda values: values[begin:end], self.rays)
        return replace(self, rays=rays, colours=self.colours[begin:end], pixels=self.pixels[begin:end])


def make_shot(tava: Checkout, dataset: Dataset, view: View, pixels: np.ndarray) -> Shot:
    """TAVA's rays through ``pixels`` [R, 2] (rows, columns) of a view, its bones and its pose."""
    person, skeleton, posed = dataset.persons[view.pose.person], dataset.skeleton, view.pose.world_from_bone
    heads, tails = bone_ends(skeleton)
    # As tava/datasets/zju_loader.py: a bone's frame is that of the joint at its head, which stands for the head.
    bones = {
        "bones_rest": (person.rest_joints[tails], translation(person.rest_joints[heads])),
        "bones_posed": (posed[tails, :3, 3], posed[heads]),
    }
    camera = view.camera
    cameras = tava.structures.Cameras(
        intrins=real(camera.intrinsics), extrins=real(np.linalg.inv(camera.world_from_camera)), distorts=None,
        width=camera.width, height=camera.height,
    )  # fmt: skip
    rows, columns = pixels.T
    rays = tava.structures.namedtuple_map(lambda values: values[rows, columns], tava.camera.generate_rays(cameras))
    frame = {
        name: tava.structures.Bones(heads=None, tails=real(ends), transforms=real(frames))
        for name, (ends, frames) in bones.items()
    } | {
        "rigid_clusters": torch.as_tensor(rigid_clusters(skeleton)),
        "pose_latent": real(pose_latent(skeleton, person.rest_joints, posed)),
        "color_bkgd": torch.zeros(3),
    }
    return Shot(rays, real(load_pixels(view).rgb[rows, columns]), frame, pixels)


def make_model(tava: Checkout, shot: Shot) -> nn.Module:
    """TAVA's full model for people with random weights."""
    torch.manual_seed(1234)  # its trainer's
    latent, transforms = len(shot.frame["pose_latent"]), int(shot.frame["rigid_clusters"].max()) + 1
    encoder = tava.snarf.SNARFDPEncoder(
        tava.posi_enc.IntegratedPositionalEncoder(), n_transforms=transforms, offset_net_enabled=True,
        offset_pose_dim=latent, offset_constant_zero=False, cano_dist=DISTANCE,
    )  # fmt: skip
    return tava.mipnerf_dyn.DynMipNerfModel(
        encoder, shading_mode="implicit_AO", shading_pose_dim=latent, world_dist=DISTANCE
    )


def selected(tava: Checkout, shot: Shot) -> np.ndarray:
    """[R] bool: rays near enough to a bone that TAVA does not drop them."""
    select = tava.mipnerf_dyn._select_rays_near_to_bones
    return select(shot.rays, shot.frame["bones_posed"], threshold=DISTANCE)[3].numpy()


@torch.no_grad()
def render(model: nn.Module, tava: Checkout, shot: Shot) -> Tensor:
    """Colours [R, 3] of the finer level, a chunk of rays at a time (``render_image`` of tava/utils/evaluation.py)."""
    model.eval()
    parts = [shot.part(tava, begin, begin + CHUNK) for begin in range(0, len(shot.pixels), CHUNK)]
    return torch.cat([model(rays=part.rays, randomized=False, **part.frame)[0][-1][0] for part in parts])


def train(model: nn.Module, optimizer: torch.optim.Optimizer, shot: Shot) -> None:
    """One step (``train_step`` of tava/engines/trainer.py)."""
    model.train()
    results, losses = model(rays=shot.rays, randomized=True, **shot.frame)
    coarse, fine = (nn.functional.mse_loss(result[0], shot.colours) for result in results)
    optimizer.zero_grad()
    loss = fine + COARSE * coarse + BONE_WEIGHTS * losses["loss_bone_w"] + BONE_OFFSET * losses["loss_bone_offset"]
    loss.backward()
    optimizer.step()


def counted(model: nn.Module, work: Callable[[], object]) -> dict[str, Any]:
    """What TAVA did in an untimed run.

    Returns:
        ``kept``: rays near enough to a bone; ``converged`` and ``evaluated``: shares of the candidates (six a sample)
        whose root was found, and that lie near enough to a bone besides, so that the field is asked.
    """
    rays, sums = [], []

    def hook(_: nn.Module, inputs: tuple[Any, ...], outputs: tuple[Any, ...]) -> None:
        rays.append(len(inputs[0]))
        sums.append([int(values.sum()) for values in (outputs[3], outputs[2])] + [outputs[2].numel()])

    handle = model.pos_enc.register_forward_hook(hook)
    work()
    handle.remove()
    converged, evaluated, count = np.sum(sums or [[0, 0, 1]], axis=0)
    return {"kept": sum(rays) // model.num_levels, "converged": converged / count, "evaluated": evaluated / count}
