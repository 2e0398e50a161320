"""The conditional radiance field on grids: one table per identity, small shared MLPs conditioned on both codes.

Same inputs and outputs as the paper's F_Θr: (x_c, v_h, v_o) → (colour, density), Lambertian colour times a
pose-dependent ambient occlusion.  Separate tables make a scene load only the identities it shows.  A joint field, for
comparison, has the paper's structure: one table for all persons and one for all objects, told apart by codes alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import relu, softplus

from chona_model.field.light import COEFFICIENTS
from chona_model.field.present import linear_of_present
from chona_model.kernels.compiled import compiles, fused_field
from chona_model.kernels.cpu.simd import LANES
from chona_model.kernels.grid import FEATURES, GridLayout, TableGradient, encode, make_layout
from chona_model.kernels.perceptron import FieldWeights, evaluate

EMPTY_BIAS = -3.0
"""Initial raw density: 100 · softplus(−4) = 1.8 / m, so that a body's depth starts half transparent."""


@dataclass(frozen=True)
class GridShape:
    """Sizes of a grid field.

    Attributes:
        levels, coarsest, finest: resolutions, metres; rows: log2 of the table rows a level.
        hidden: width of the MLPs; features: geometry features handed from density to colour.
        code: length of an identity code; pose: length of the bottleneck of the pose code.
        density_scale: 1/m; the density is ``density_scale · softplus(raw − 1)``.
        joint: whether all persons read one table and all objects another.
        own_codes: whether persons and objects are conditioned on their own code alone.
    """

    levels: int = 8
    coarsest: float = 0.12
    finest: float = 0.004
    rows: int = 17
    hidden: int = 32
    features: int = 15
    code: int = 8
    pose: int = 8
    density_scale: float = 100.0
    joint: bool = False
    own_codes: bool = False

    def __post_init__(self) -> None:
        limits = {"levels": (1, 32), "rows": (1, 24), "hidden": (1, 1024), "code": (1, 1024), "pose": (1, 1024)}
        wrong = [name for name, (low, high) in limits.items() if not low <= getattr(self, name) <= high]
        if wrong or not (1e-5 <= self.finest <= self.coarsest <= 10.0 and 0.0 < self.density_scale <= 1e6):
            raise ValueError(f"{wrong or 'cells or density_scale'} of a grid field out of range: {self}")
        if self.levels * FEATURES % LANES or self.hidden % LANES or not 0 < self.features < LANES:
            raise ValueError(
                f"the kernels want whole vectors of {LANES}: levels · {FEATURES} and hidden as multiples of it, "
                f"features below it; got {self.levels} levels, {self.hidden} hidden units and {self.features} features"
            )


class GridField(nn.Module):
    """Density and colour of all identities.

    Args:
        shape: sizes.
        lower, upper: [I, 3] boxes of the parts (persons first, then objects), metres, each in its own frame.
        persons: number of persons among the parts.
        pose_code: length of the full pose code.

    Attributes:
        table_of: [I] int32 the table that each part reads; lower: [tables, 3] the corner that it begins at, metres.
    """

    def __init__(self, shape: GridShape, lower: np.ndarray, upper: np.ndarray, persons: int, pose_code: int) -> None:
        super().__init__()
        self.shape = shape
        self.persons = persons
        parts = len(lower)
        own = (np.arange(parts) >= persons) * int(persons > 0) if shape.joint else np.arange(parts)
        corners = np.stack([lower[own == table].min(axis=0) for table in range(own.max() + 1)])
        self.table_of: Tensor
        self.register_buffer("table_of", torch.as_tensor(own, dtype=torch.int32), persistent=False)
        self.lower: Tensor
        self.register_buffer("lower", torch.as_tensor(corners, dtype=torch.float32))
        self.layout: GridLayout = make_layout(
            (upper - corners[own]).max(axis=0), shape.coarsest, shape.finest, shape.levels, 1 << shape.rows
        )
        table = torch.rand(len(corners), shape.levels, 1 << shape.rows, FEATURES) * 2e-4 - 1e-4
        self.table = nn.Parameter(table)
        self.gradient = TableGradient(table)
        self.person_codes = nn.Parameter(0.1 * torch.randn(max(persons, 1), shape.code))
        self.object_codes = nn.Parameter(0.1 * torch.randn(max(parts - persons, 1), shape.code))
        inputs = shape.levels * FEATURES
        self.density_in = nn.Linear(inputs, shape.hidden)
        self.density_code = nn.Linear(2 * shape.code, shape.hidden, bias=False)
        self.density_out = nn.Linear(shape.hidden, 1 + shape.features)
        self.colour_in = nn.Linear(inputs + shape.features, shape.hidden)
        self.colour_code = nn.Linear(2 * shape.code, shape.hidden, bias=False)
        self.colour_out = nn.Linear(shape.hidden, 3)
        self.pose_in = nn.Linear(pose_code, shape.pose)
        self.shade_in = nn.Linear(shape.features + shape.pose, 32)
        self.shade_out = nn.Linear(32, 1)
        self.light = nn.Parameter(torch.zeros(COEFFICIENTS, 3))
        with torch.no_grad():
            # Nearly transparent at first: an opaque hull would only ever be carved from outside.
            self.density_out.bias[0] = EMPTY_BIAS

    def codes(self, pairs: Tensor) -> Tensor:
        """[Q, 2 · code] of identity pairs [Q, 2] (person, object); −1 gives a zero code."""
        present = (pairs >= 0).to(self.person_codes.dtype)
        person = self.person_codes[pairs[:, 0].clamp(min=0)] * present[:, :1]
        thing = self.object_codes[pairs[:, 1].clamp(min=0)] * present[:, 1:]
        return torch.cat([person, thing], dim=1)

    def forward(
        self, points: Tensor, part: Tensor, pairs: Tensor, pair: Tensor, pose_codes: Tensor | None, pose: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Evaluates candidates.

        Args:
            points: [M, 3] in the part's own frame, metres; part: [M] int32.
            pairs: [Q, 2] int64 identity pairs in use; pair: [M] int64 index of each point's.
            pose_codes: [P, C], or None for no shading; pose: [M] int64.

        Returns:
            density [M] 1/m and rgb [M, 3] sRGB in 0…1.
        """
        part = self.table_of[part.long()]
        local = (points - self.lower[part.long()]).clamp(min=0.0)
        weights = self.weights(self.codes(pairs), pose_codes)
        if compiles(local):
            scale = self.shape.density_scale
            return fused_field(local, part, self.table, self.layout, weights, pair, pose, scale)
        gradient = self.gradient if self.table.requires_grad and torch.is_grad_enabled() else None
        encoded = encode(local, part, self.table, self.layout, gradient)
        return evaluate(encoded, weights, pair, pose, self.shape.density_scale)

    def weights(self, codes: Tensor, pose_codes: Tensor | None) -> FieldWeights:
        """Codes and pose reach the perceptrons as biases, computed once a pair and once a pose."""
        features = self.shape.features
        shade = None
        if pose_codes is not None:
            pose = torch.tanh(linear_of_present(self.pose_in, pose_codes))
            shade = pose @ self.shade_in.weight[:, features:].T + self.shade_in.bias
        return FieldWeights(
            self.density_in.weight, self.density_in.bias + self.density_code(codes), self.density_out.weight,
            self.density_out.bias, self.colour_in.weight, self.colour_in.bias + self.colour_code(codes),
            self.colour_out.weight, self.colour_out.bias, self.shade_in.weight[:, :features], shade,
            self.shade_out.weight, self.shade_out.bias,
        )  # fmt: skip

    def density(self, points: Tensor, part: Tensor, pairs: Tensor, pair: Tensor) -> Tensor:
        """Density alone [M], 1/m, without gradients: for occupancy."""
        with torch.no_grad():
            return self.shape.density_scale * softplus(self.raw_density(points, part, pairs, pair) - 1.0)

    def raw_density(self, points: Tensor, part: Tensor, pairs: Tensor, pair: Tensor) -> Tensor:
        """What the density is a softplus of: [M], differentiable in the parameters."""
        part = self.table_of[part.long()]
        local = (points - self.lower[part.long()]).clamp(min=0.0)
        gradient = self.gradient if self.table.requires_grad and torch.is_grad_enabled() else None
        encoded = encode(local, part, self.table, self.layout, gradient)
        hidden = self.density_in(encoded) + self._gather(self.density_code(self.codes(pairs)), pair)
        return relu(hidden) @ self.density_out.weight[0] + self.density_out.bias[0]

    @staticmethod
    def _gather(rows: Tensor, index: Tensor) -> Tensor:
        return rows if len(rows) == 1 else rows[index]
