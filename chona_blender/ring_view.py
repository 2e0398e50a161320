"""Draws the capture's cameras into the 3D views, following the settings; nothing is put into the scene.

Where the performance takes place is sampled when the cameras are switched on, and when character, object or frames are
set. Where the cameras stand follows from that and the settings in closed form, whenever a setting has changed, also by
undo.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from .areas import redraw_areas
from .capture_ring import Ring, Space, cut_off, ring_poses, ring_radius
from .errors import ChonaError
from .rig.sampling import sample

COLOUR, SHORT_COLOUR, CIRCLE_COLOUR = (0.35, 0.75, 1.0, 1.0), (1.0, 0.45, 0.15, 1.0), (0.35, 0.75, 1.0, 0.35)
LINE_WIDTH = 1.6
SIZE = 0.1
"""Length of a drawn camera, as a share of the radius."""
_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))
_CIRCLE = 96


@dataclass(frozen=True)
class Place:
    """Where the performance takes place: its points [F, P, 3] in Blender's world, metres, and the space around them."""

    points: np.ndarray
    space: Space


@dataclass(frozen=True)
class Lines:
    """What is drawn, pairs of points [L, 2, 3]: cameras that see everything, those that do not, and the rings."""

    key: tuple[object, ...]
    whole: np.ndarray
    short: np.ndarray
    circles: np.ndarray
    words: str


class _View:
    handle: object | None = None
    scene = 0
    place: Place | None = None
    lines: Lines | None = None
    problem = ""


def is_on() -> bool:
    """Whether cameras are drawn."""
    return _View.handle is not None


def words(scene: bpy.types.Scene) -> str:
    """What the panel says about the drawn cameras, or why there are none; nothing while they are off."""
    if not is_on() or scene.session_uid != _View.scene:
        return ""
    return _View.problem or (_View.lines.words if _View.lines is not None else "")


def problem(scene: bpy.types.Scene) -> bool:
    """Whether the cameras cannot be drawn."""
    return is_on() and scene.session_uid == _View.scene and bool(_View.problem)


def switch(scene: bpy.types.Scene, on: bool) -> None:
    """Draw the cameras of a scene, or no more."""
    if _View.handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_View.handle, "WINDOW")
        _View.handle = None
    _View.place = _View.lines = None
    if on:
        _View.scene = scene.session_uid
        _View.handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
        refresh(scene)
    redraw()


def refresh(scene: bpy.types.Scene) -> None:
    """Sample anew where the performance takes place, if its cameras are drawn."""
    if not is_on() or scene.session_uid != _View.scene:
        return
    _View.problem, _View.place, _View.lines = "", None, None
    try:
        _View.place = place_of(scene)
        _View.lines = lines_of(scene.chona, _View.place)
    except ChonaError as error:
        _View.problem = " ".join(str(error).split())
    redraw()


def place_of(scene: bpy.types.Scene) -> Place:
    """Where the character's bones and the object are over the frames of the capture.

    Raises:
        ChonaError: no character, or one that cannot be sampled.
    """
    settings = scene.chona
    armature, thing = settings.capture_armature, settings.capture_object
    if armature is None:
        raise ChonaError("Choose the armature of the character to see the cameras")
    names = [bone.name for bone in armature.data.bones if bone.use_deform]
    samples = sample(scene, armature, names, [] if thing is None else [thing], frames=settings.capture_frames())
    heads = np.array([armature.data.bones[name].head_local for name in names]).reshape(-1, 3)
    homogeneous = np.concatenate([heads, np.ones((len(heads), 1))], axis=1)
    joints = np.einsum("fbij,bj->fbi", samples.world_from_armature, homogeneous)[..., :3]
    points = np.concatenate([joints, samples.world_from_object[..., :3, 3]], axis=1)
    if not points.size:
        raise ChonaError(f"Armature '{armature.name}' has no deforming bone. Switch Deform on for the bones to capture")
    return Place(points, Space.around(points))


def _key(settings: Any) -> tuple[object, ...]:
    return settings.capture_ring(), settings.capture_width, settings.capture_height


def lines_of(settings: Any, place: Place) -> Lines:
    """What there is to draw for the settings."""
    ring: Ring = settings.capture_ring()
    width, height = settings.capture_width, settings.capture_height
    poses = ring_poses(ring, place.space, width, height)
    radius = ring_radius(ring, place.space, width, height)
    short = cut_off(poses, place.points, ring.lens, width, height)
    drawn = np.array([camera_lines(pose, SIZE * radius, ring.lens, width, height) for pose in poses])
    said = f"{ring.cameras} cameras at {radius:.2f} m"
    said += f"; {int(short.sum())} do not see all of the character" if short.any() else ", all see the whole character"
    if ring.radius > 0.0 and place.space.across > ring.radius:
        said = f"The character leaves the ring: set a radius over {place.space.across:.2f} m, or 0 to have it fitted"
    return Lines(
        _key(settings), drawn[~short].reshape(-1, 2, 3), drawn[short].reshape(-1, 2, 3),
        _circles(ring, radius, place.space), said,
    )  # fmt: skip


def camera_lines(pose: np.ndarray, length: float, lens: float, width: int, height: int) -> np.ndarray:
    """[L, 2, 3] the pyramid that a camera sees, ``length`` long, and a mark on its upper side."""
    longer = 18.0 / lens * length
    right, up = longer * min(width / height, 1.0), longer * min(height / width, 1.0)
    local = np.array([[x * right, y * up, -length] for x, y in _CORNERS])
    top = np.array([[-0.5 * right, 1.15 * up, -length], [0.0, 1.8 * up, -length], [0.5 * right, 1.15 * up, -length]])
    tip = np.zeros(3)
    pairs = [(tip, corner) for corner in local]
    pairs += [(local[index], local[(index + 1) % 4]) for index in range(4)]
    pairs += [(top[index], top[(index + 1) % 3]) for index in range(3)]
    return np.array(pairs) @ pose[:3, :3].T + pose[:3, 3]


def _circles(ring: Ring, radius: float, space: Space) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, _CIRCLE + 1)
    found = []
    for level in range(ring.rings):
        height = space.middle[2] + ring.height + ring.spacing * (level - (ring.rings - 1) / 2.0)
        x, y = space.middle[0] + radius * np.cos(angle), space.middle[1] + radius * np.sin(angle)
        points = np.stack([x, y, np.full_like(x, height)], axis=1)
        found.append(np.stack([points[:-1], points[1:]], axis=1))
    return np.concatenate(found)


def _draw() -> None:
    context = bpy.context
    if _View.place is None or context.scene.session_uid != _View.scene:
        return
    settings = context.scene.chona
    if _View.lines is None or _View.lines.key != _key(settings):
        _View.lines = lines_of(settings, _View.place)
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    shader.uniform_float("viewportSize", (context.region.width, context.region.height))
    shader.uniform_float("lineWidth", LINE_WIDTH * context.preferences.system.ui_scale)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    lines = _View.lines
    for pairs, colour in ((lines.circles, CIRCLE_COLOUR), (lines.whole, COLOUR), (lines.short, SHORT_COLOUR)):
        if len(pairs):
            shader.uniform_float("color", colour)
            batch_for_shader(shader, "LINES", {"pos": pairs.reshape(-1, 3).tolist()}).draw(shader)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def redraw() -> None:
    """Have 3D views and their sidebars drawn again."""
    redraw_areas("VIEW_3D")


@bpy.app.handlers.persistent
def _file_loaded(*_: object) -> None:
    if is_on():
        switch(bpy.context.scene, on=False)


def register() -> None:
    """Another file has other scenes."""
    bpy.app.handlers.load_post.append(_file_loaded)


def unregister() -> None:
    """Draw no more."""
    bpy.app.handlers.load_post.remove(_file_loaded)
    if is_on():
        switch(bpy.context.scene, on=False)
