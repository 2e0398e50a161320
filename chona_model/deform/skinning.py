"""Forward skinning: canonical points to the posed world, with learned weights and a pose-dependent offset.

The paper's  x_p = (Σ_j w_j T_j + w_bg I) x_c + F_Δ(x_c, P)  and its exact Jacobian ∂x_p/∂x_c by three forward-mode
tangents through the same matrix products, without a graph.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from chona_model.field.encodings import encoding_size, positional_encoding, positional_encoding_tangents
from chona_model.field.mlp import ConditionedMLP
from chona_model.figure import PoseBatch

OFFSET_START = 1e-4
"""Scale of the offset's last layer at the start: less than a millimetre, yet not so dead that nothing learns."""


@dataclass(frozen=True)
class DeformShape:
    """Sizes of the skinning and offset perceptrons; the defaults are TAVA's.

    Attributes:
        degrees: octaves of the plain positional encoding.
        width, depth: of the hidden layers.
        sharpness: factor on the logits before softmax; larger learns one-hot weights faster.
    """

    degrees: int = 4
    width: int = 128
    depth: int = 4
    sharpness: float = 5.0

    def __post_init__(self) -> None:
        if not (0 <= self.degrees <= 32 and 1 <= self.width <= 8192 and 1 <= self.depth <= 128):
            raise ValueError(f"sizes of the skinning perceptrons out of range: {self}")
        if not 0.0 < self.sharpness <= 1e4:
            raise ValueError(f"the sharpness of the skinning weights is {self.sharpness}, expected 0 to 10,000")


class _PointMLP(nn.Module):
    """A perceptron over encoded canonical points, normalised by (x - centre) / scale."""

    def __init__(
        self, shape: DeformShape, outputs: int, condition: int, centre: tuple[float, ...], scale: float
    ) -> None:
        super().__init__()
        self.shape, self.scale = shape, scale
        self.register_buffer("centre", torch.tensor(centre, dtype=torch.float64), persistent=False)
        inputs = encoding_size(shape.degrees, identity=True)
        self.mlp = ConditionedMLP(inputs, shape.width, shape.depth, condition=condition, outputs=outputs)

    def run(self, x: Tensor, condition: Tensor | None = None, index: Tensor | None = None) -> Tensor:
        unit = (x - self.get_buffer("centre").to(x)) / self.scale
        return self.mlp(positional_encoding(unit, self.shape.degrees), condition, index)

    def run_with_tangents(
        self, x: Tensor, condition: Tensor | None = None, index: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        unit = (x - self.get_buffer("centre").to(x)) / self.scale
        encoded = positional_encoding(unit, self.shape.degrees)
        tangents = positional_encoding_tangents(unit, self.shape.degrees) / self.scale
        return self.mlp.with_tangents(encoded, tangents, condition, index)


class SkinningMLP(_PointMLP):
    """F_Θs: canonical points [M, 3] (metres) to weights [M, J + 1] of J bones and, last, the background."""

    def __init__(self, shape: DeformShape, bones: int, centre: tuple[float, ...], scale: float) -> None:
        super().__init__(shape, bones + 1, 0, centre, scale)

    def logits(self, x: Tensor) -> Tensor:
        """[M, J + 1] before softmax, sharpness applied."""
        return self.run(x) * self.shape.sharpness

    def forward(self, x: Tensor, present: Tensor | None = None) -> Tensor:
        """Weights [M, J + 1] that sum to 1; bones where ``present`` ([M, J] or [1, J] bool) is False get exactly 0."""
        return softmax_weights(self.logits(x), present)

    def with_tangents(self, x: Tensor, present: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Weights [M, J + 1] and their derivatives by the point's coordinates [3, M, J + 1]."""
        logits, tangents = self.run_with_tangents(x)
        weights = softmax_weights(logits * self.shape.sharpness, present)
        slopes = tangents * self.shape.sharpness
        return weights, weights * (slopes - (weights * slopes).sum(dim=-1, keepdim=True))


class OffsetMLP(_PointMLP):
    """F_Δ: canonical points [M, 3] and a pose code to offsets [M, 3] in root space, metres; about 0 at the start."""

    def __init__(self, shape: DeformShape, pose: int, centre: tuple[float, ...], scale: float) -> None:
        super().__init__(shape, 3, pose, centre, scale)
        assert self.mlp.output is not None
        nn.init.uniform_(self.mlp.output.weight, -OFFSET_START, OFFSET_START)

    def forward(self, x: Tensor, codes: Tensor, index: Tensor | None = None) -> Tensor:
        """Offsets for poses ``codes`` [P, C] of which each point's is ``index`` [M] (None where P is 1 or M)."""
        return self.run(x, codes, index)


def softmax_weights(logits: Tensor, present: Tensor | None = None) -> Tensor:
    """Softmax over [M, J + 1] (the background last) by log-softmax, in float32 at least.

    Logits may be as large as float32 holds; those of absent bones become -inf.  The background is never absent, so a
    row always has a finite logit.
    """
    wide = logits.float() if logits.dtype in {torch.float16, torch.bfloat16} else logits
    if present is not None:
        background = torch.ones_like(present[:, :1])
        wide = wide.masked_fill(~torch.cat([present, background], dim=-1), -torch.inf)
    return torch.log_softmax(wide, dim=-1).exp()


class ForwardSkinning(nn.Module):
    """Weights, bones and offset together.

    Args:
        bones: J, body bones and object slots.
        pose: length of the pose codes.
        centre, scale: of canonical space, metres.
    """

    def __init__(self, shape: DeformShape, bones: int, pose: int, centre: tuple[float, ...], scale: float) -> None:
        super().__init__()
        self.skinning = SkinningMLP(shape, bones, centre, scale)
        self.offset = OffsetMLP(shape, pose, centre, scale)

    def weights(self, x: Tensor, poses: PoseBatch, index: Tensor) -> Tensor:
        """Skinning weights [M, J + 1] of canonical points; bones absent from the point's pose weigh nothing."""
        return self.skinning(x, _rows(poses.present, index))

    def forward(self, x: Tensor, poses: PoseBatch, index: Tensor, offset: bool = True) -> Tensor:
        """Canonical points to root space.

        Args:
            x: [M, 3] metres.
            index: [M] pose of each point.
            offset: whether F_Δ is added.

        Returns:
            [M, 3] metres.
        """
        matrices = blend(self.weights(x, poses, index), poses.transforms, index)
        posed = _apply(matrices, x)
        return posed + self.offset(x, poses.codes, index) if offset else posed

    def with_jacobian(self, x: Tensor, poses: PoseBatch, index: Tensor, offset: bool = True) -> tuple[Tensor, Tensor]:
        """As ``forward``, and the Jacobian [M, 3, 3] (row: posed coordinate, column: canonical coordinate).

        ∂x_p/∂x_c = A(w) + Σ_j (T_j x) ∂w_j/∂x + ∂F_Δ/∂x, with A the blended 3x3 part.
        """
        weights, slopes = self.skinning.with_tangents(x, _rows(poses.present, index))
        blended = blend(torch.cat([weights[None], slopes]), poses.transforms, index)
        posed = _apply(blended[0], x)
        jacobian = blended[0, ..., :3] + _apply(blended[1:], x).movedim(0, -1)
        if offset:
            moved, tangents = self.offset.run_with_tangents(x, poses.codes, index)
            posed, jacobian = posed + moved, jacobian + tangents.movedim(0, -1)
        return posed, jacobian


def _rows(per_pose: Tensor, index: Tensor) -> Tensor:
    """[P, …] to [M, …], or to [1, …] for a single pose, which broadcasts."""
    return per_pose if len(per_pose) == 1 else per_pose.index_select(0, index)


def blend(weights: Tensor, transforms: Tensor, index: Tensor) -> Tensor:
    """Blended matrices Σ_j w_j T_j + w_bg I.

    Args:
        weights: [..., M, J + 1], the background last.
        transforms: [P, J, 4, 4].
        index: [M] pose of each point.

    Returns:
        [..., M, 3, 4].
    """
    rows = transforms[:, :, :3, :].flatten(-2)
    identity = torch.eye(3, 4, dtype=rows.dtype, device=rows.device).reshape(1, 1, 12).expand(len(rows), 1, 12)
    rows = torch.cat([rows, identity], dim=1)
    if len(rows) == 1:
        return (weights @ rows[0]).unflatten(-1, (3, 4))
    return torch.einsum("...mj,mjk->...mk", weights, rows.index_select(0, index)).unflatten(-1, (3, 4))


def _apply(matrices: Tensor, x: Tensor) -> Tensor:
    return (matrices[..., :3] @ x[..., None])[..., 0] + matrices[..., 3]
