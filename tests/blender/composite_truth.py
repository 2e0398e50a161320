"""Layers among wires: what has to be seen, counted at 32 × 32 points a pixel, and how far Blender's picture is off.

Run with a Python with bpy, it prints the table of docs/compositing.md:
`python tests/blender/composite_truth.py PYTHON_WITH_BPY`
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import OpenEXR
from operation_helpers import run_bpy

WIDTH, HEIGHT = 48, 24
POINTS = 32
SAMPLES = 256
PLANE = (0.1, 0.7, 0.1)
EMPTY = 1e10


@dataclass(frozen=True)
class Bar:
    """A flat bar across the picture: `left` and `width` in pixels at the top row, `slope` pixels to the right a row."""

    left: float
    width: float
    slope: float
    depth: float
    colour: tuple[float, float, float]

    def corners(self) -> list[list[float]]:
        """Clockwise from the upper left, picture y down."""
        shift, top, bottom = self.slope * (HEIGHT + 2), -1.0, HEIGHT + 1.0
        start = self.left - self.slope
        ends = [[start + shift, bottom], [start + shift + self.width, bottom]]
        return [*ends, [start + self.width, top], [start, top]]

    def covers(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether points of the picture are on it."""
        left = self.left + self.slope * y
        return (x >= left) & (x < left + self.width)


@dataclass(frozen=True)
class Layer:
    """A figure: opaque between two soft edges of `soft` pixels, along x or y."""

    name: str
    depth: float
    colour: tuple[float, float, float]
    card: float
    stand_in: float = 0.0
    along: str = "x"
    soft: float = 4.0

    def alpha(self) -> np.ndarray:
        """[H, W]."""
        x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        place, size = (x, WIDTH) if self.along == "x" else (y, HEIGHT)
        return np.clip((size * 0.38 - np.abs(place - size / 2)) / self.soft + 0.5, 0.0, 1.0).astype(np.float16) * 1.0


@dataclass(frozen=True)
class Case:
    """One scene: `film` is transparent and without the plane behind."""

    bars: dict[str, Bar]
    layers: tuple[Layer, ...]
    film: bool = False


RED, BLUE, DARK = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9), (0.02, 0.02, 0.03)
FIGURE = Layer("figure", 5.0, (0.8, 0.6, 0.4), 5.0)
THIN = Bar(8.3, 0.3, 0.9, 2.5, DARK)
THICK = Bar(14.3, 3.4, 0.45, 3.0, RED)
CASES = {
    "over a plane": Case({}, (FIGURE,)),
    "before a wire": Case({"behind": Bar(8.3, 0.3, 0.9, 6.5, DARK)}, (FIGURE,)),
    "behind a wire": Case({"thin": THIN}, (FIGURE,)),
    "behind a bar": Case({"thick": THICK}, (FIGURE,)),
    "between wires": Case({"thin": THIN, "thick": THICK, "behind": Bar(24.4, 0.6, -0.3, 6.5, BLUE)}, (FIGURE,)),
    "transparent film": Case({"thin": THIN, "thick": THICK}, (FIGURE,), film=True),
    "two layers": Case({}, (FIGURE, Layer("far", 6.0, BLUE, 6.0, along="y"))),
    "two layers, nearer last": Case({}, (Layer("far", 6.0, BLUE, 6.0, along="y"), FIGURE)),
    "two layers and wires": Case(
        {"thin": THIN, "between": Bar(24.4, 0.6, -0.3, 5.5, RED)}, (FIGURE, Layer("far", 6.0, BLUE, 6.0, along="y"))
    ),
    "bar within the figure's depth": Case({"bar": Bar(14.3, 3.4, 0.45, 5.2, RED)}, (replace(FIGURE, card=5.5),)),
    "wire within, with a stand-in": Case(
        {"wire": Bar(14.3, 0.4, 0.45, 5.2, RED)}, (replace(FIGURE, card=5.5, stand_in=5.01),)
    ),
}  # fmt: skip


def write_layer(path: Path, layer: Layer) -> None:
    """The layer's frame as docs/file-formats.md has it."""
    alpha = layer.alpha()
    colour = np.concatenate([alpha[..., None] * np.array(layer.colour), alpha[..., None]], axis=-1)
    channels = {
        "CHONA.Combined": colour.astype(np.float16),
        "CHONA.Depth.Z": np.where(alpha > 0, layer.depth, EMPTY).astype(np.float32),
        "CHONA.Human.V": alpha.astype(np.float16),
    }
    OpenEXR.File({"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}, channels).write(str(path))


def truth(case: Case) -> np.ndarray:
    """[H, W, 4]: every point of every pixel composited from back to front, then averaged."""
    step = (np.arange(POINTS) + 0.5) / POINTS
    y, x = np.meshgrid(
        (np.arange(HEIGHT)[:, None] + step).ravel(), (np.arange(WIDTH)[:, None] + step).ravel(), indexing="ij"
    )
    picture = np.zeros((*x.shape, 4))
    if not case.film:
        picture[:] = (*PLANE, 1.0)
    for item in sorted((*case.bars.values(), *case.layers), key=lambda item: -item.depth):
        if isinstance(item, Bar):
            alpha = item.covers(x, y).astype(float)
        else:
            alpha = np.kron(item.alpha(), np.ones((POINTS, POINTS)))
        colour = np.array([*item.colour, 1.0])
        picture = picture * (1.0 - alpha[..., None]) + alpha[..., None] * colour
    return picture.reshape(HEIGHT, POINTS, WIDTH, POINTS, 4).mean(axis=(1, 3))


def is_edge(case: Case) -> np.ndarray:
    """[H, W]: pixels that a bar covers in part."""
    step = (np.arange(POINTS) + 0.5) / POINTS
    y, x = np.meshgrid(
        (np.arange(HEIGHT)[:, None] + step).ravel(), (np.arange(WIDTH)[:, None] + step).ravel(), indexing="ij"
    )
    edge = np.zeros((HEIGHT, WIDTH), bool)
    for bar in case.bars.values():
        share = bar.covers(x, y).reshape(HEIGHT, POINTS, WIDTH, POINTS).mean(axis=(1, 3))
        edge |= (share > 0.0) & (share < 1.0)
    return edge


def render_cases(python: str, folder: Path) -> None:
    """Blender's pictures of all cases, as `<case> depth.exr` and `<case> refined.exr`."""
    cases = {}
    for name, case in CASES.items():
        for layer in case.layers:
            write_layer(folder / f"{name} {layer.name}_0001.exr", layer)
        cases[name] = {
            "film": case.film,
            "bars": {
                key: {"corners": bar.corners(), "depth": bar.depth, "colour": bar.colour}
                for key, bar in case.bars.items()
            },
            "layers": [
                {"name": f"{name} {layer.name}", "card": layer.card, "stand_in": layer.stand_in}
                for layer in case.layers
            ],
        }
    plan = {"size": [WIDTH, HEIGHT], "samples": SAMPLES, "plane": PLANE, "cases": cases}
    (folder / "plan.json").write_text(json.dumps(plan))
    run_bpy(python, "composite_edges.py", folder / "plan.json", folder)


def error(folder: Path, name: str, edges: str) -> np.ndarray:
    """[H, W] the largest difference of the four channels."""
    channels = OpenEXR.File(str(folder / f"{name} {edges}.exr"), separate_channels=True).channels()
    picture = np.stack([channels[letter].pixels for letter in "RGBA"], axis=-1)
    return np.abs(picture - truth(CASES[name])).max(axis=-1)


def main() -> None:
    """Prints the table."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        render_cases(sys.argv[1], folder)
        print("| scene | Depth: mean | largest | Refined: mean | largest |\n|---|---|---|---|---|")
        for name, case in CASES.items():
            where = is_edge(case) if case.bars else np.ones((HEIGHT, WIDTH), bool)
            found = [error(folder, name, edges)[where] for edges in ("depth", "refined")]
            words = [f"{each.mean():.3f} | {each.max():.3f}" for each in found]
            print(f"| {name} | {' | '.join(words)} |")


if __name__ == "__main__":
    main()
