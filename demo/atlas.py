"""A texture with a tile for every quad, so that colours can be painted in space instead of on an unfolded sheet.

Each quad owns ``TILE`` × ``TILE`` texels; the quad's corners lie on the centres of the tile's corner texels, so linear
filtering never reaches a neighbour's tile and there are no seams.
"""

from __future__ import annotations

import numpy as np

TILE = 6


def atlas_size(quads: int) -> tuple[int, int]:
    """Tiles in a row and rows of tiles for so many quads."""
    columns = int(np.ceil(np.sqrt(quads)))
    return columns, int(np.ceil(quads / columns))


def texel_points(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """[F, TILE, TILE, 3] positions in space of all texels (row, then column)."""
    share = np.linspace(0.0, 1.0, TILE)
    down, across = np.meshgrid(share, share, indexing="ij")
    weights = np.stack([(1 - across) * (1 - down), across * (1 - down), across * down, (1 - across) * down], axis=-1)
    return np.einsum("rck,fkd->frcd", weights, vertices[quads])


def corner_uvs(quads: int) -> np.ndarray:
    """[F, 4, 2] texture coordinates of the quads' corners, Blender's v pointing up."""
    columns, rows = atlas_size(quads)
    number = np.arange(quads)
    origin = np.stack([number % columns, number // columns], axis=-1)[:, None] * TILE
    inner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    texel = origin + 0.5 + inner * (TILE - 1)
    return texel / (TILE * np.array([columns, rows]))


def pack(colours: np.ndarray) -> np.ndarray:
    """The image [H, W, 3] of colours [F, TILE, TILE, 3], first row at the bottom as Blender keeps its pixels."""
    quads = len(colours)
    columns, rows = atlas_size(quads)
    padded = np.zeros((rows * columns, TILE, TILE, 3), dtype=colours.dtype)
    padded[:quads] = colours
    return padded.reshape(rows, columns, TILE, TILE, 3).transpose(0, 2, 1, 3, 4).reshape(rows * TILE, columns * TILE, 3)


def hash_noise(cells: np.ndarray, seed: int = 0) -> np.ndarray:
    """Repeatable values in 0…1 for integer lattice cells [..., 3]."""
    mixed = cells.astype(np.int64) @ np.array([73856093, 19349663, 83492791]) + np.int64(seed) * 40503
    mixed = (mixed ^ (mixed >> 13)) * np.int64(1274126177) & np.int64(0x7FFFFFFF)
    return ((mixed ^ (mixed >> 16)) & 0xFFFF) / 65535.0


def smooth_noise(points: np.ndarray, size: float | tuple[float, float, float], seed: int = 0) -> np.ndarray:
    """Value noise in 0…1 with features of ``size`` metres (one number, or one for each axis)."""
    position = points / np.asarray(size)
    base = np.floor(position).astype(np.int64)
    share = position - base
    share = share * share * (3 - 2 * share)
    value = np.zeros(points.shape[:-1])
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, share, 1 - share), axis=-1)
        value += weight * hash_noise(base + np.array(corner), seed)
    return value
