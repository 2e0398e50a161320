"""Proportions of the demo's character, Robin: rest joints, clothes and skin as shapes, skinning weights.

Blender's axes (z up), T-pose facing −y, metres.  Plain numpy: nothing here needs bpy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from demo.sdf import FAR, Grid, RoundCone, ellipsoid, grid_around, sample, smooth_minimum, surface_nets, union

PERSON = "Robin"

BONES = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
"""SMPL's names in SMPL's order (Blender's process cannot import chona_model; a test compares the two)."""
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)

_LEFT_JOINTS = {
    "pelvis": (0.0, 0.0, 0.925),
    "left_hip": (0.088, 0.0, 0.870),
    "left_knee": (0.100, -0.008, 0.480),
    "left_ankle": (0.106, 0.022, 0.088),
    "left_foot": (0.116, -0.098, 0.030),
    "spine1": (0.0, 0.008, 1.020),
    "spine2": (0.0, 0.014, 1.130),
    "spine3": (0.0, 0.012, 1.225),
    "neck": (0.0, 0.012, 1.395),
    "head": (0.0, -0.004, 1.475),
    "left_collar": (0.060, 0.008, 1.335),
    "left_shoulder": (0.158, 0.010, 1.352),
    "left_elbow": (0.415, 0.016, 1.352),
    "left_wrist": (0.650, 0.008, 1.352),
    "left_hand": (0.728, 0.006, 1.348),
}
CROWN = (0.0, -0.004, 1.72)
"""Top of the head, where its bone ends."""


def rest_joints() -> np.ndarray:
    """[24, 3] rest joints, Blender's axes."""
    joints = []
    for name in BONES:
        mirrored = name.startswith("right_")
        joint = np.array(_LEFT_JOINTS[name.replace("right_", "left_")])
        joints.append(joint * [-1.0, 1.0, 1.0] if mirrored else joint)
    return np.array(joints)


def bone_tails() -> np.ndarray:
    """[24, 3] ends of the bones: the next joint, or where a leaf's flesh ends."""
    joints = rest_joints()
    following = {"pelvis": "spine1", "spine3": "neck"}
    tails = joints.copy()
    for index, name in enumerate(BONES):
        children = [child for child, parent in enumerate(PARENTS) if parent == index]
        if name in following:
            tails[index] = joints[BONES.index(following[name])]
        elif children:
            tails[index] = joints[children].mean(axis=0)
        elif name == "head":
            tails[index] = CROWN
        elif name.endswith("foot"):
            tails[index] = joints[index] + [0.0, -0.075, 0.0]
        else:
            tails[index] = joints[index] + np.sign(joints[index][0]) * np.array([0.09, 0.0, 0.0])
    return tails


def _mirrored(shapes: list[RoundCone]) -> list[RoundCone]:
    """The shapes and their mirror images in x."""
    flip = np.array([-1.0, 1.0, 1.0])

    def mirror(shape: RoundCone) -> RoundCone:
        start, end = (tuple(float(v) for v in np.array(point) * flip) for point in (shape.start, shape.end))
        return RoundCone(start, end, shape.start_radius, shape.end_radius, shape.stretch, shape.blend)

    return [*shapes, *(mirror(shape) for shape in shapes)]


HEAD = np.array([0.0, -0.016, 1.595])
"""Centre of the skull."""


def _skin() -> list[RoundCone]:
    x, y, z = HEAD
    head = [
        ellipsoid((x, y + 0.004, z + 0.010), (0.102, 0.114, 0.118)),
        ellipsoid((x, y - 0.026, z - 0.062), (0.074, 0.076, 0.068), 0.05),
        ellipsoid((x, y - 0.108, z - 0.024), (0.015, 0.017, 0.014), 0.02),
        RoundCone((x, y - 0.098, z + 0.008), (x, y - 0.108, z - 0.018), 0.008, 0.010, blend=0.02),
        RoundCone((0.0, 0.014, 1.37), (0.0, 0.0, 1.50), 0.052, 0.050, blend=0.03),
    ]
    ears = [ellipsoid((x + 0.103, y + 0.010, z - 0.014), (0.014, 0.022, 0.030), 0.012)]
    arm = [
        RoundCone((0.30, 0.014, 1.352), (0.415, 0.016, 1.352), 0.043, 0.037, blend=0.02),
        RoundCone((0.415, 0.016, 1.352), (0.50, 0.013, 1.351), 0.037, 0.038, blend=0.02),
        RoundCone((0.50, 0.013, 1.351), (0.650, 0.008, 1.352), 0.038, 0.026, blend=0.02),
        RoundCone((0.655, 0.008, 1.352), (0.728, 0.004, 1.350), 0.028, 0.040, (1.0, 1.0, 0.55), 0.02),
        RoundCone((0.675, -0.012, 1.350), (0.706, -0.052, 1.343), 0.016, 0.013, blend=0.012),
        RoundCone((0.706, -0.052, 1.343), (0.737, -0.062, 1.340), 0.013, 0.011, blend=0.008),
    ]
    fingers = [(-0.026, 0.098, 0.0108), (-0.008, 0.112, 0.0112), (0.011, 0.104, 0.0108), (0.029, 0.082, 0.0095)]
    for across, length, radius in fingers:
        root = (0.735, 0.004 + across, 1.349)
        arm.append(
            RoundCone(
                root, (0.735 + length - 0.012, 0.004 + 1.12 * across, 1.340), radius, radius - 0.0015, blend=0.005
            )
        )
    return head + _mirrored(ears + arm)


def _hair() -> list[RoundCone]:
    x, y, z = HEAD
    back = [
        ellipsoid((x, y + 0.026, z + 0.030), (0.112, 0.112, 0.118)),
        ellipsoid((x, y + 0.052, z - 0.028), (0.098, 0.076, 0.072), 0.04),
        # A bun: a shape that shows whether the head's bone is followed.
        ellipsoid((x, y + 0.095, z + 0.112), (0.050, 0.048, 0.046), 0.012),
    ]
    fringe = [
        RoundCone((0.030, y - 0.075, z + 0.100), (-0.078, y - 0.070, z + 0.058), 0.034, 0.022, blend=0.02),
        RoundCone((0.030, y - 0.075, z + 0.100), (0.088, y - 0.052, z + 0.050), 0.032, 0.020, blend=0.02),
        RoundCone((0.0, y - 0.045, z + 0.112), (0.0, y + 0.030, z + 0.122), 0.044, 0.050, blend=0.03),
    ]
    sides = [RoundCone((0.094, y - 0.024, z + 0.050), (0.101, y - 0.022, z - 0.030), 0.018, 0.010, blend=0.02)]
    return back + fringe + _mirrored(sides)


def _shirt() -> list[RoundCone]:
    torso = [
        RoundCone((0.0, 0.010, 0.99), (0.0, 0.010, 1.12), 0.132, 0.128, (1.0, 0.76, 1.0), 0.03),
        RoundCone((0.0, 0.008, 1.14), (0.0, 0.008, 1.26), 0.130, 0.146, (1.0, 0.76, 1.0), 0.05),
        ellipsoid((0.0, 0.010, 1.325), (0.130, 0.088, 0.075), 0.05),
        RoundCone((0.0, 0.013, 1.375), (0.0, 0.010, 1.398), 0.066, 0.061, blend=0.03),
    ]
    sleeve = [
        RoundCone((0.055, 0.010, 1.352), (0.158, 0.010, 1.345), 0.060, 0.062, (1.0, 0.95, 1.0), 0.05),
        RoundCone((0.158, 0.010, 1.346), (0.345, 0.014, 1.350), 0.062, 0.053, blend=0.03),
    ]
    return torso + _mirrored(sleeve)


def _trousers() -> list[RoundCone]:
    hips = [
        ellipsoid((0.0, 0.008, 0.930), (0.148, 0.112, 0.098)),
        ellipsoid((0.0, 0.006, 1.010), (0.139, 0.107, 0.050), 0.04),
    ]
    leg = [
        ellipsoid((0.070, 0.036, 0.890), (0.086, 0.092, 0.090), 0.04),
        RoundCone((0.082, 0.0, 0.870), (0.100, -0.006, 0.500), 0.092, 0.063, blend=0.03),
        RoundCone((0.100, -0.006, 0.500), (0.104, 0.010, 0.330), 0.063, 0.060, blend=0.03),
        RoundCone((0.104, 0.010, 0.330), (0.106, 0.020, 0.145), 0.060, 0.053, blend=0.03),
        RoundCone((0.106, 0.019, 0.165), (0.106, 0.020, 0.135), 0.057, 0.057, blend=0.006),
    ]
    return hips + _mirrored(leg)


def _shoes() -> list[RoundCone]:
    shoe = [
        RoundCone((0.106, 0.026, 0.125), (0.106, 0.026, 0.060), 0.040, 0.046, blend=0.02),
        RoundCone((0.107, 0.030, 0.045), (0.116, -0.105, 0.040), 0.043, 0.042, (1.0, 1.0, 0.95), 0.03),
        ellipsoid((0.118, -0.118, 0.040), (0.049, 0.062, 0.040), 0.02),
        # The sole: wider than what it carries.
        RoundCone((0.107, 0.036, 0.016), (0.118, -0.122, 0.016), 0.046, 0.052, (1.0, 1.0, 0.32), 0.008),
    ]
    return _mirrored(shoe)


PARTS = ("skin", "hair", "shirt", "trousers", "shoes")


@dataclass(frozen=True)
class BodySurface:
    """The character's skin and clothes as one closed surface.

    Attributes:
        vertices: [V, 3] metres, Blender's axes.
        quads: [F, 4] counter-clockwise from outside.
        weights: [V, 24] rows sum to one, at most four of them above zero.
        grid, fields: distances of each part, to tell which part a point of the surface belongs to.
    """

    vertices: np.ndarray
    quads: np.ndarray
    weights: np.ndarray
    grid: Grid
    fields: dict[str, np.ndarray]

    def part_of(self, points: np.ndarray) -> np.ndarray:
        """[N] index into PARTS of the part nearest to each point."""
        return np.argmin([sample(self.grid, self.fields[name], points) for name in PARTS], axis=0)


def build_body(step: float = 0.0075) -> BodySurface:
    """The surface at a lattice of ``step`` metres."""
    grid = grid_around((-0.90, -0.22, -0.03), (0.90, 0.22, 1.80), step)
    makers = {"skin": _skin, "hair": _hair, "shirt": _shirt, "trousers": _trousers, "shoes": _shoes}
    fields = {name: union(grid, makers[name]()) for name in PARTS}
    # Hair ends where the face begins: a crease, cut slanting from the forehead to below the ears.
    points = grid.points((0, 0, 0), grid.shape)
    local = points - HEAD
    face = 0.93 * (local[..., 1] + 0.052) + 0.36 * (0.052 - local[..., 2])
    fields["hair"] = np.maximum(fields["hair"], np.where(local[..., 2] < 0.046, -face, -FAR))
    # The ground is flat under the shoes.
    fields["shoes"] = np.maximum(fields["shoes"], -points[..., 2])
    whole = np.full(grid.shape, FAR)
    for name in PARTS:
        whole = smooth_minimum(whole, fields[name], 0.006)
    vertices, quads = surface_nets(grid, whole)
    return BodySurface(vertices, quads, skin_weights(vertices, quads), grid, fields)


_FLESH = {
    "pelvis": 0.105, "spine1": 0.105, "spine2": 0.105, "spine3": 0.115, "neck": 0.05, "head": 0.115, "collar": 0.055,
    "shoulder": 0.050, "elbow": 0.037, "wrist": 0.030, "hand": 0.020, "hip": 0.083, "knee": 0.060, "ankle": 0.042,
    "foot": 0.040,
}  # fmt: skip
"""Radius of the flesh around each bone, metres: distances to bones are taken from there."""


def skin_weights(vertices: np.ndarray, quads: np.ndarray, softness: float = 0.016, rounds: int = 24) -> np.ndarray:
    """Smooth weights [V, 24] from distances to the fleshed bones, evened out over the surface.

    Args:
        softness: distance over which one bone's weight falls by a factor e, metres.
        rounds: passes of averaging over neighbours.
    """
    heads, tails = rest_joints(), bone_tails()
    distance = np.empty((len(vertices), len(BONES)))
    for index, name in enumerate(BONES):
        radius = _FLESH[name.split("_")[-1]]
        distance[:, index] = RoundCone(tuple(heads[index]), tuple(tails[index]), radius, radius).distance(vertices)
    weights = np.exp(-(distance - distance.min(axis=1, keepdims=True)) / softness)
    weights /= weights.sum(axis=1, keepdims=True)
    edges = np.concatenate([quads[:, [i, (i + 1) % 4]] for i in range(4)])
    edges = np.concatenate([edges, edges[:, ::-1]])
    order = np.argsort(edges[:, 0], kind="stable")
    source, target = edges[order].T
    starts = np.searchsorted(source, np.arange(len(vertices)))
    count = np.diff(np.append(starts, len(source)))[:, None]
    for _ in range(rounds):
        weights = 0.5 * weights + 0.5 * np.add.reduceat(weights[target], starts, axis=0) / count
    cut = np.sort(weights, axis=1)[:, -4:-3]
    weights = np.where(weights >= np.maximum(cut, 1e-3), weights, 0.0)
    return weights / weights.sum(axis=1, keepdims=True)
