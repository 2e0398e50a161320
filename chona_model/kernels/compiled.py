"""The field on a GPU as one function: torch.compile fuses lookups, interpolation and perceptrons into Triton kernels.

The function is made of the plain torch twins, so it is compared with them. Where torch.compile has no C compiler to
build its launchers with, the twins run as they are: nothing has to be installed for a GPU to work.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from functools import cache

import torch
from torch import Tensor

from chona_model.kernels.grid import GridLayout
from chona_model.kernels.perceptron import FieldWeights
from chona_model.kernels.reference.encode import encode_levels
from chona_model.kernels.reference.perceptron import perceptron

Field = Callable[..., tuple[Tensor, Tensor]]


def fused_field(
    points: Tensor, identity: Tensor, table: Tensor, layout: GridLayout, weights: FieldWeights, pair: Tensor,
    pose: Tensor, density_scale: float, backend: str = "inductor",
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Density [M] 1/m and rgb [M, 3]; arguments as ``reference.encode``'s and ``reference.perceptron``'s."""
    cells, dims, dense = layout.inverse_cells.tolist(), layout.dims.tolist(), layout.dense.tolist()
    return _compiled(backend)(
        points, identity, table, tuple(cells), tuple(map(tuple, dims)), tuple(dense), layout.rows, weights, pair, pose,
        density_scale,
    )  # fmt: skip


def compiles(tensor: Tensor) -> bool:
    """Whether the compiled field is for this tensor: on a CUDA card, with a C compiler at hand."""
    return tensor.is_cuda and _compiler()


@cache
def _compiler() -> bool:
    return any(shutil.which(name) for name in (os.environ.get("CC"), "cc", "gcc", "clang") if name)


@cache
def _compiled(backend: str) -> Field:
    return torch.compile(_field, dynamic=True, fullgraph=True, backend=backend)


def _field(
    points: Tensor, identity: Tensor, table: Tensor, cells: tuple[float, ...], dims: tuple[tuple[int, ...], ...],
    dense: tuple[bool, ...], rows: int, weights: FieldWeights, pair: Tensor, pose: Tensor, density_scale: float,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    encoded = encode_levels(points, identity, table, cells, dims, dense, rows)
    return perceptron(encoded, weights, pair, pose, density_scale)
