"""Parts of which every answer is known, and checks of meshes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from chona_model.standin.surface import Surface


@dataclass
class FormPart:
    """A part given by its signed distance [N] (negative inside) at points [N, 3] and a constant density, 1/m.

    ``sharp``: density is a point's, as a grid model's; else averaged over cubes, as the exact model's.
    """

    distance: Callable[[np.ndarray], np.ndarray]
    inside: float
    sharp: bool = True
    half: float = 0.5
    kind: str = "object"
    name: str = "form"

    def __post_init__(self) -> None:
        self.lower, self.upper = np.full(3, -self.half), np.full(3, self.half)

    def holds(self, points: np.ndarray) -> np.ndarray:
        return (np.abs(points) <= self.half).all(axis=1)

    def density(self, points: np.ndarray, width: float) -> np.ndarray:
        """Of the cube's share that is inside, as far as the distance to a plane says it."""
        share = np.clip(0.5 - self.distance(points) / (1e-9 if self.sharp else width), 0.0, 1.0)
        return (self.inside * share).astype(np.float32)

    def colour(self, points: np.ndarray, width: float) -> np.ndarray:
        return shade(points)

    def weights(self, points: np.ndarray) -> np.ndarray:
        return np.zeros((len(points), 0))


def shade(points: np.ndarray) -> np.ndarray:
    """[N, 3] a colour for every place: linear in its coordinates."""
    return np.clip(0.5 + 0.8 * points, 0.0, 1.0).astype(np.float32)


def ball(radius: float, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Callable[[np.ndarray], np.ndarray]:
    """Signed distance of a ball."""
    return lambda points: np.linalg.norm(points - np.array(centre), axis=1) - radius


def union(*forms: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """Signed distance of several, exact outside."""
    return lambda points: np.min([form(points) for form in forms], axis=0)


def edges_are_shared(faces: np.ndarray) -> bool:
    """Whether every directed edge has exactly one that runs the other way: closed, and turned alike everywhere."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    there, back = edges[:, 0] << 32 | edges[:, 1], edges[:, 1] << 32 | edges[:, 0]
    return len(np.unique(there)) == len(there) and np.array_equal(np.sort(there), np.sort(back))


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Cubic metres inside; positive where faces turn outwards."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


def pieces(surface: Surface) -> int:
    """Connected pieces of a mesh."""
    label = np.arange(len(surface.vertices))
    while True:
        low = label[surface.faces].min(axis=1)
        new = label.copy()
        np.minimum.at(new, surface.faces.ravel(), np.repeat(low, 3))
        if np.array_equal(new, label):
            return len(np.unique(label[surface.faces]))
        label = new
