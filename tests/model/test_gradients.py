"""Implicit gradients of roots against central finite differences of the whole solve, float64."""

from __future__ import annotations

import dataclasses

import torch
from exact_cases import SHAPE, pose_batch, random_figure, small_model

from chona_model.deform.gradients import attach_implicit_gradients
from chona_model.deform.inverse import find_roots
from chona_model.figure import PoseBatch
from chona_model.settings import InverseSettings

COUNT = 6
STEP = 1e-6
TIGHT = InverseSettings(tolerance=1e-14, steps=60)


class Case:
    """A few points with their roots, and a scalar of the roots whose gradient is compared."""

    def __init__(self) -> None:
        self.model = small_model(3)
        self.poses = pose_batch(random_figure(1.0, 1), random_figure(0.7, 2))
        self.index = torch.arange(COUNT) % 2
        generator = torch.Generator().manual_seed(4)
        self.x = 0.5 * torch.randn(COUNT, 3, generator=generator, dtype=torch.float64)
        self.direction = torch.randn(COUNT, 3, generator=generator, dtype=torch.float64)
        with torch.no_grad():
            self.targets = self.model.deform(self.x, self.poses, self.index)

    def solve(self, poses: PoseBatch, targets: torch.Tensor) -> torch.Tensor:
        """The root next to the known one, without a graph."""

        def warp(x: torch.Tensor, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            return self.model.deform.with_jacobian(x, poses, self.index[rows])

        usable = torch.ones(COUNT, 1, dtype=torch.bool)
        roots = find_roots(warp, targets, self.x[:, None].clone(), usable, size=SHAPE.size, settings=TIGHT)
        assert (roots.residuals < 1e-12).all()
        return roots.points[:, 0]

    def scalar(self, poses: PoseBatch, targets: torch.Tensor) -> torch.Tensor:
        """The same with implicit gradients."""
        root = self.solve(poses, targets)
        with torch.no_grad():
            jacobian = self.model.deform.with_jacobian(root, poses, self.index)[1]
        posed = self.model.deform(root, poses, self.index)
        attached, passing = attach_implicit_gradients(root, posed, targets, jacobian)
        assert passing.all()
        torch.testing.assert_close(attached, root, rtol=0, atol=0)
        return (attached * self.direction).sum()

    def difference(self, tensor: torch.Tensor, position: int, poses: PoseBatch, targets: torch.Tensor) -> float:
        """Central difference of the solved scalar by one entry of a tensor that the solve depends on."""
        flat, values = tensor.detach().view(-1), []
        for sign in (1, -1):
            flat[position] += sign * STEP
            values.append(float((self.solve(poses, targets) * self.direction).sum()))
            flat[position] -= sign * STEP
        return (values[0] - values[1]) / (2 * STEP)


def compare(case: Case, tensor: torch.Tensor, poses: PoseBatch, targets: torch.Tensor, entries: int = 6) -> None:
    (gradient,) = torch.autograd.grad(case.scalar(poses, targets), tensor)
    largest = gradient.abs().flatten().topk(entries).indices.tolist()
    for position in largest:
        expected = case.difference(tensor, position, poses, targets)
        got = float(gradient.flatten()[position])
        assert abs(got) > 1e-4
        assert abs(got - expected) < 1e-5 * max(abs(expected), 0.1), (position, got, expected)


def test_by_the_posed_points() -> None:
    case = Case()
    compare(case, case.targets.requires_grad_(), case.poses, case.targets, entries=18)


def test_by_the_transforms() -> None:
    case = Case()
    transforms = case.poses.transforms.clone().requires_grad_()
    compare(case, transforms, dataclasses.replace(case.poses, transforms=transforms), case.targets)


def test_by_the_pose_code() -> None:
    case = Case()
    codes = case.poses.codes.clone().requires_grad_()
    compare(case, codes, dataclasses.replace(case.poses, codes=codes), case.targets)


def test_by_the_skinning_parameters() -> None:
    case = Case()
    for parameter in case.model.deform.skinning.parameters():
        compare(case, parameter, case.poses, case.targets, entries=2)


def test_by_the_offset_parameters() -> None:
    case = Case()
    for parameter in case.model.deform.offset.parameters():
        compare(case, parameter, case.poses, case.targets, entries=2)


def test_ill_conditioned_and_failed_rows_pass_nothing() -> None:
    root = torch.rand(3, 3, dtype=torch.float64)
    posed = torch.zeros(3, 3, dtype=torch.float64, requires_grad=True)
    jacobian = torch.eye(3, dtype=torch.float64).repeat(3, 1, 1)
    jacobian[1, 2, 2] = 1e-9
    usable = torch.tensor([True, True, False])
    attached, passing = attach_implicit_gradients(root, posed, torch.zeros(3, 3).double(), jacobian, usable)
    assert passing.tolist() == [True, False, False]
    attached.sum().backward()
    assert posed.grad is not None
    assert posed.grad.tolist() == [[-1.0] * 3, [0.0] * 3, [0.0] * 3]
