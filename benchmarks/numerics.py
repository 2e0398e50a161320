"""The errors that ``docs/numerics.md`` tabulates: float32 and bfloat16 against float64, at the ends of the ranges."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor

from benchmarks.common import Bench, save
from benchmarks.recovery_cases import PLAIN, random_poses
from chona_model.deform.skinning import softmax_weights
from chona_model.field.encodings import integrated_encoding
from chona_model.figure import Rig, make_figure
from chona_model.geometry import inverse_3x3, segment_distances
from chona_model.kernels import reference
from chona_model.kernels.grid import FEATURES, encode, make_layout
from chona_model.kernels.perceptron import FieldWeights, evaluate
from chona_model.kernels.volume import integrate
from chona_model.render.frustum import conical_frusta
from chona_model.render.integration import ray_weights

SEED = 0


def measure(_: Bench) -> None:
    """Writes ``numerics.json``."""
    save("numerics", {"errors": {name: errors(work, dtypes) for name, work, dtypes in subjects()}, **origin()})


Work = Callable[[torch.dtype], Tensor]

BOTH, SINGLE = (torch.float32, torch.bfloat16), (torch.float32,)


def errors(work: Work, dtypes: tuple[torch.dtype, ...]) -> dict[str, float]:
    """Largest absolute difference from float64, by precision."""
    exact = work(torch.float64)
    return {str(dtype).removeprefix("torch."): float((work(dtype).double() - exact).abs().max()) for dtype in dtypes}


def drawn(*size: int) -> Tensor:
    """Numbers of 0…1 that bfloat16 holds exactly, so that the arithmetic is measured and not the rounding before it."""
    return torch.rand(*size, generator=torch.Generator().manual_seed(SEED)).bfloat16().double()


def subjects() -> Iterator[tuple[str, Work, tuple[torch.dtype, ...]]]:
    """What is computed, in any precision."""
    for exponent in (-30, 0, 4, 30):
        scale = 10.0**exponent
        density = (scale * drawn(64, 64)).float().double()
        yield f"ray weights at optical depths up to 1e{exponent}", lambda t, d=density: weights_of(d.to(t)), BOTH
        yield (
            f"weights and transmittance less 1, optical depths up to 1e{exponent}",
            lambda t, d=density: total_of(d.to(t)), BOTH,
        )  # fmt: skip
        yield (
            f"fused integration at optical depths up to 1e{exponent}", lambda t, d=density: packed(d.to(t), integrate),
            SINGLE,
        )  # fmt: skip
        yield (
            f"its twin at optical depths up to 1e{exponent}",
            lambda t, d=density: packed(d.to(t), reference.integrate), SINGLE,
        )  # fmt: skip
    logits = (2e4 * drawn(200, 26) - 1e4).bfloat16().double()
    yield "skinning weights of logits ±1e4", lambda t: softmax_weights(logits.to(t)), BOTH
    for variance in (0.0, 1.0, 1e30):
        yield (
            f"integrated encoding, 10 octaves, variance {variance:g}",
            lambda t, v=variance: integrated_encoding(
                (6 * drawn(50, 3) - 3).bfloat16().to(t), torch.full((50, 3), v, dtype=t), 10
            ),
            BOTH,
        )  # fmt: skip
    for depth in (1.0, 1e18):
        yield f"frusta from 0 to {depth:g}, relative to depth²", lambda t, d=depth: frusta(d, t), SINGLE
    yield "inverses of rotations", lambda t: inverse_3x3(rotations().to(t)).matrix, SINGLE
    yield "distances to bones of length 0 … 1e-6", short_bones, SINGLE
    yield "grid encoding inside its box", lambda t: encoded(drawn(500, 3) * 0.7, t), SINGLE
    yield "grid encoding 1 km outside its box", lambda t: encoded(drawn(500, 3) * 1e3 + 2, t), SINGLE
    for scale in (1.0, 1e4):
        yield f"perceptrons' density over its largest, logits ±{scale:g}", lambda t, s=scale: density_of(s, t), SINGLE


def weights_of(density: Tensor) -> Tensor:
    """Weights of intervals of 1 m."""
    return ray_weights(density, torch.ones_like(density)).weights


def total_of(density: Tensor) -> Tensor:
    """What should be 1."""
    light = ray_weights(density, torch.ones_like(density))
    return light.weights.double().sum(dim=-1) + light.remaining.double()


def packed(density: Tensor, function: Callable[..., tuple[Tensor, Tensor]]) -> Tensor:
    """Pixels of candidates an interval of 1 m apart."""
    count, dtype = density.numel(), density.dtype
    first = torch.arange(0, count + 1, density.shape[1])
    depth = torch.arange(density.shape[1], dtype=dtype).repeat(len(density)) + 1
    rgb = drawn(count, 3).to(dtype)
    thing = torch.arange(count) % 3 == 0
    out = function(density.flatten(), rgb, first, depth, torch.ones(count, dtype=dtype), thing, 0.0)[0]
    return out[:, [0, 1, 2, 3, 5]]


def frusta(depth: float, dtype: torch.dtype) -> Tensor:
    """Means and covariances along a ray, in units of the depth."""
    edges = torch.linspace(0, 1, 17, dtype=torch.float64)[None].to(dtype) * depth
    direction, radius = torch.tensor([[0.25, -0.5, 1.0]], dtype=dtype), torch.tensor([1 / 1024], dtype=dtype)
    depths, means, covariances = conical_frusta(torch.zeros(1, 3, dtype=dtype), direction, radius, edges)
    return torch.cat([depths.flatten() / depth, means.flatten() / depth, (covariances / depth / depth).flatten()])


def rotations() -> Tensor:
    """[N, 3, 3] of random poses."""
    return torch.tensor(np.stack(random_poses(PLAIN, 3.1, 40, SEED))[..., :3, :3].reshape(-1, 3, 3))


def short_bones(dtype: torch.dtype) -> Tensor:
    """Distances of points to four bones."""
    tails = torch.zeros(4, 3, dtype=torch.float64)
    tails[:, 0] = torch.tensor([0.0, 1e-30, 1e-20, 1e-6])
    return segment_distances(drawn(50, 1, 3).to(dtype), torch.zeros(4, 3, dtype=dtype), tails.to(dtype))


def encoded(points: Tensor, dtype: torch.dtype) -> Tensor:
    """Features of a table of ±1, cells from 20 cm to 1.2 cm."""
    layout = make_layout(np.array([0.9, 1.1, 0.7]), coarsest=0.2, finest=0.012, levels=5, rows=1024)
    table = 2 * drawn(1, 5, 1024, FEATURES) - 1
    return encode(points.to(dtype), torch.zeros(len(points), dtype=torch.int32), table.to(dtype), layout)


def density_of(scale: float, dtype: torch.dtype) -> Tensor:
    """Density of perceptrons whose last layer is multiplied by ``scale``, over the largest."""
    generator = torch.Generator().manual_seed(SEED)

    def made(*size: int, times: float = 1.0) -> Tensor:
        return (times * torch.randn(*size, generator=generator)).to(dtype)

    weights = FieldWeights(
        made(32, 16), made(1, 32), made(16, 32, times=scale), made(16), made(32, 31), made(1, 32), made(3, 32),
        made(3), made(32, 15), made(1, 32), made(1, 32), made(1),
    )  # fmt: skip
    rows = torch.zeros(200, dtype=torch.int64)
    return evaluate(drawn(200, 16).to(dtype), weights, rows, rows, 25.0)[0] / (25.0 * scale * 32)


def origin() -> dict[str, dict[str, float]]:
    """Largest change of a transform relative to the root, metres, when a figure stands so far from the origin."""
    rig, found = Rig(PLAIN.skeleton, PLAIN.joints, 1.0), {}
    pose = random_poses(PLAIN, 1.5, 1, SEED)[0]
    here = make_figure(rig, pose, np.zeros((0, 4, 4)), 0).transforms
    for metres in (1e4, 1e6):
        moved = pose.copy()
        moved[:, :3, 3] += metres
        there = make_figure(rig, moved, np.zeros((0, 4, 4)), 0).transforms
        found[f"{metres:g} m"] = float(np.abs(there - here).max())
    return {"transforms_far_from_the_origin": found}
