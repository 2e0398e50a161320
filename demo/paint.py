"""Robin's colours, as functions of the rest position: eyes, hair strands, stripes, dungarees, shoes.

sRGB in 0…1, positions in metres in Blender's axes.  Plain numpy.
"""

from __future__ import annotations

import numpy as np

from demo.atlas import smooth_noise
from demo.body import HEAD, PARTS

SKIN, BLUSH, LIPS = (0.86, 0.62, 0.48), (0.88, 0.45, 0.38), (0.69, 0.31, 0.28)
HAIR, HAIR_LIGHT = (0.30, 0.13, 0.07), (0.52, 0.26, 0.12)
CREAM, TEAL = (0.93, 0.88, 0.77), (0.09, 0.46, 0.47)
DENIM, DENIM_LIGHT, STITCH = (0.13, 0.21, 0.40), (0.23, 0.34, 0.56), (0.89, 0.62, 0.23)
RED, WHITE, BRASS = (0.78, 0.16, 0.12), (0.93, 0.92, 0.88), (0.80, 0.62, 0.25)


class Canvas:
    """Colours of points [N, 3], painted over one another with soft masks [N]."""

    def __init__(self, points: np.ndarray) -> None:
        self.x, self.y, self.z = points[:, 0], points[:, 1], points[:, 2]
        self.points = points
        self.colour = np.zeros_like(points)

    def lay(self, mask: np.ndarray | float, colour: tuple[float, float, float]) -> None:
        """Blends a colour in where the mask is above zero."""
        mask = np.clip(np.broadcast_to(mask, len(self.points)), 0.0, 1.0)[:, None]
        self.colour = self.colour * (1 - mask) + np.array(colour) * mask

    def shade(self, factor: np.ndarray) -> None:
        """Multiplies brightness by [N]."""
        self.colour = self.colour * factor[:, None]


def edge(distance: np.ndarray, width: float = 0.0015) -> np.ndarray:
    """1 where a signed distance (metres) is negative, 0 outside, soft over ``width``."""
    return np.clip(0.5 - distance / width, 0.0, 1.0)


def line(distance: np.ndarray, half: float) -> np.ndarray:
    """A line of half width ``half`` metres around zero distance."""
    return edge(np.abs(distance) - half)


def dashes(along: np.ndarray, period: float = 0.012) -> np.ndarray:
    """On for six tenths of each period: stitches."""
    return (np.mod(along, period) < 0.6 * period).astype(float)


def _ellipse(u: np.ndarray, v: np.ndarray, radius_u: float, radius_v: float) -> np.ndarray:
    return edge((np.sqrt((u / radius_u) ** 2 + (v / radius_v) ** 2) - 1) * min(radius_u, radius_v))


def _skin(canvas: Canvas) -> None:
    canvas.lay(1.0, SKIN)
    canvas.shade(0.97 + 0.06 * smooth_noise(canvas.points, 0.02))
    u, v, front = np.abs(canvas.x - HEAD[0]), canvas.z - HEAD[2], canvas.y < HEAD[1] - 0.03
    canvas.lay(0.55 * front * np.exp(-(((u - 0.056) / 0.020) ** 2) - ((v + 0.042) / 0.017) ** 2), BLUSH)
    canvas.lay(0.45 * front * np.exp(-((u / 0.014) ** 2) - ((v + 0.026) / 0.012) ** 2), BLUSH)
    ears = (u > 0.098) & ~front
    canvas.lay(0.35 * ears, BLUSH)
    canvas.lay(front * _ellipse(u - 0.040, v - 0.000, 0.0205, 0.0235), (0.24, 0.12, 0.09))
    canvas.lay(front * _ellipse(u - 0.040, v + 0.0015, 0.0185, 0.0205), (0.97, 0.96, 0.93))
    canvas.lay(front * _ellipse(u - 0.0385, v + 0.001, 0.0130, 0.0165), (0.20, 0.36, 0.22))
    canvas.lay(front * _ellipse(u - 0.0385, v + 0.001, 0.0075, 0.0105), (0.04, 0.03, 0.03))
    canvas.lay(
        front * _ellipse(canvas.x - HEAD[0] - np.where(canvas.x > 0, 0.043, -0.034), v - 0.007, 0.0042, 0.0048),
        (1.0, 1.0, 1.0),
    )
    brow = v - 0.040 + 6.0 * (u - 0.038) ** 2
    canvas.lay(front * line(brow, 0.0042) * edge(np.abs(u - 0.041) - 0.022), HAIR)
    smile = v + 0.064 - 7.5 * u**2
    canvas.lay(front * line(smile, 0.0034) * edge(u - 0.028), LIPS)
    canvas.lay(front * edge(np.abs(v + 0.0675 - 5.0 * u**2) - 0.0032) * edge(u - 0.014), (0.80, 0.42, 0.38))
    freckles = smooth_noise(canvas.points, 0.006, 3) > 0.80
    canvas.lay(0.30 * front * freckles * (np.abs(v + 0.034) < 0.018) * (u < 0.07), (0.58, 0.33, 0.20))
    for x, nail in ((0.842, 0.008),):
        canvas.lay(0.25 * edge(x - nail - np.abs(canvas.x)), BLUSH)
    # A watch on the left wrist: it shows whether the forearm's twist is followed.
    canvas.lay(line(canvas.x - 0.628, 0.011), (0.12, 0.10, 0.10))
    canvas.lay(_ellipse(canvas.x - 0.628, canvas.y - 0.008, 0.015, 0.015) * (canvas.z > 1.36), (0.85, 0.84, 0.80))


def _hair(canvas: Canvas) -> None:
    canvas.lay(1.0, HAIR)
    strands = smooth_noise(canvas.points, (0.008, 0.05, 0.05), 5)
    canvas.lay(0.75 * strands**2, HAIR_LIGHT)
    bun = np.linalg.norm(canvas.points - (HEAD + [0.0, 0.060, 0.085]), axis=-1)
    canvas.lay(line(bun - 0.033, 0.006), TEAL)


def _denim(canvas: Canvas, mask: np.ndarray) -> None:
    twill = smooth_noise(canvas.points, (0.004, 0.004, 0.014), 7)
    worn = smooth_noise(canvas.points, 0.07, 8)
    canvas.lay(mask, DENIM)
    canvas.lay(mask * (0.35 * twill + 0.45 * np.clip(worn * 2 - 0.9, 0, 1)), DENIM_LIGHT)


def _shirt(canvas: Canvas) -> None:
    x, y, z = canvas.x, canvas.y, canvas.z
    side = np.abs(x)
    # Stripes run around the torso and, past the shoulder, around the sleeves.
    along = np.where(side > 0.165, side + 0.012, z)
    canvas.lay(1.0, CREAM)
    canvas.lay(edge(0.011 - np.abs(np.mod(along, 0.044) - 0.022)), TEAL)
    canvas.lay(edge(0.325 - side), TEAL)
    canvas.lay(edge(1.383 - z) * (side < 0.09), TEAL)
    canvas.shade(0.95 + 0.08 * smooth_noise(canvas.points, 0.012, 4))
    front = y < 0.01
    bib = edge(np.maximum(side - 0.092 - 0.16 * np.clip(1.10 - z, 0, 1), z - 1.268)) * front
    waist = edge(z - 1.075)
    strap_centre = np.where(front, 0.074, 0.020 + 0.42 * np.clip(z - 1.09, 0.0, 0.17))
    strap = edge(np.abs(side - strap_centre) - 0.019) * (z > 1.05)
    denim = np.maximum(np.maximum(bib, waist), strap)
    _denim(canvas, denim)
    canvas.lay(denim * (1 - strap) * front * line(z - 1.259, 0.0016) * dashes(x), STITCH)
    canvas.lay(strap * line(np.abs(side - strap_centre) - 0.015, 0.0012) * dashes(z), STITCH)
    canvas.lay(denim * line(z - 1.066, 0.0014) * dashes(x + y), STITCH)
    pocket = np.maximum(np.abs(x) - 0.048, np.abs(z - 1.175) - 0.042)
    canvas.lay(0.8 * front * edge(pocket), DENIM_LIGHT)
    canvas.lay(front * line(pocket + 0.004, 0.0014) * dashes(x + z), STITCH)
    star = _star(x, z - 1.170, 0.030)
    canvas.lay(front * star, STITCH)
    canvas.lay(front * _ellipse(side - 0.074, z - 1.245, 0.012, 0.012), BRASS)


def _star(u: np.ndarray, v: np.ndarray, radius: float) -> np.ndarray:
    """A five-pointed star of the given outer radius, metres."""
    angle = np.mod(np.arctan2(u, v) + np.pi / 5, 2 * np.pi / 5) - np.pi / 5
    distance = np.hypot(u, v)
    return edge(distance * (np.cos(angle) + 1.35 * np.abs(np.sin(angle))) - radius)


def _trousers(canvas: Canvas) -> None:
    x, y, z = canvas.x, canvas.y, canvas.z
    side = np.abs(x)
    _denim(canvas, np.ones(len(x)))
    canvas.lay(line(z - 0.985, 0.0014) * dashes(x + y), STITCH)
    canvas.lay(line(y - 0.012, 0.0015) * dashes(z) * (side > 0.05) * (z > 0.17), STITCH)
    slanted = side - 0.118 + 0.55 * (z - 0.90)
    canvas.lay((y < 0) * line(slanted, 0.0016) * (np.abs(z - 0.935) < 0.045) * dashes(z), STITCH)
    seat = np.maximum(np.abs(side - 0.072) - 0.042, np.abs(z - 0.905) - 0.042)
    canvas.lay((y > 0.03) * line(seat, 0.0016) * dashes(x + z), STITCH)
    # A sewn-on patch on one knee tells left from right.
    patch = np.maximum(np.abs(x - 0.100) - 0.036, np.abs(z - 0.495) - 0.040)
    canvas.lay((y < 0) * edge(patch), RED)
    canvas.lay((y < 0) * edge(patch) * ((np.mod(x + 0.006, 0.018) < 0.006) | (np.mod(z, 0.018) < 0.006)), CREAM)
    canvas.lay((y < 0) * line(patch, 0.0022) * dashes(x + z), STITCH)
    canvas.lay(edge(z - 0.182), DENIM_LIGHT)
    canvas.lay(line(z - 0.175, 0.0014) * dashes(np.arctan2(y - 0.02, side - 0.106) * 0.057), CREAM)


def _shoes(canvas: Canvas) -> None:
    x, y, z = canvas.x, canvas.y, canvas.z
    canvas.lay(1.0, RED)
    across = np.abs(np.abs(x) - 0.112)
    tongue = (across < 0.017) & (y < -0.035) & (y > -0.125) & (z > 0.05)
    canvas.lay(0.9 * tongue, (0.55, 0.09, 0.08))
    canvas.lay((across < 0.024) * (y < -0.030) * (y > -0.120) * (z > 0.05) * (np.mod(y, 0.020) < 0.008), WHITE)
    canvas.lay(edge(y + 0.148) * edge(z - 0.060), WHITE)
    canvas.lay(edge(z - 0.030), WHITE)
    canvas.lay(line(z - 0.022, 0.0025), TEAL)


def paint_body(points: np.ndarray, part: np.ndarray) -> np.ndarray:
    """[N, 3] sRGB of rest positions [N, 3] that belong to PARTS[part]."""
    painters = {"skin": _skin, "hair": _hair, "shirt": _shirt, "trousers": _trousers, "shoes": _shoes}
    colour = np.empty_like(points)
    for index, name in enumerate(PARTS):
        chosen = part == index
        canvas = Canvas(points[chosen])
        painters[name](canvas)
        colour[chosen] = canvas.colour
    return np.clip(colour, 0.0, 1.0)
