"""Draws the live preview's newest picture over the camera's frame, in the 3D views that look through the camera.

What is drawn is handed over before; drawing places it. A picture is put on the graphics card when it is first drawn,
because only then has Blender its context ready.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import blf
import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from .camera import ImageFormat

TEXT_SIZE = 12.0
MARGIN = 8.0
VERTEX = "void main() { at = uv; gl_Position = ModelViewProjectionMatrix * vec4(pos, 0.0, 1.0); }"
FRAGMENT = "void main() { colour = opacity * texture(image, at); }"
"""Scene-linear as it comes: a view's frame buffer encodes as sRGB what is written, and blends before that."""


@dataclass(frozen=True)
class Rectangle:
    """Part of a region, pixels from its lower left corner."""

    left: float
    bottom: float
    width: float
    height: float


@dataclass(frozen=True)
class Picture:
    """What is shown: [H, W, 4] float32 premultiplied, scene-linear, and which part of the camera's frame it is."""

    rgba: np.ndarray
    image: ImageFormat


def camera_views(scene: bpy.types.Scene) -> Iterator[tuple[bpy.types.Region, bpy.types.RegionView3D]]:
    """The regions on the screen that look through the scene's camera."""
    for window in bpy.context.window_manager.windows:
        if window.scene != scene:
            continue
        for area in window.screen.areas:
            if area.type != "VIEW_3D":
                continue
            space = area.spaces.active
            for region in area.regions:
                view = (
                    region.data or space.region_3d
                )  # of a quad view's quarter; Blender without a window has no `data`
                if region.type == "WINDOW" and _looks_through(space, view, scene):
                    yield region, view


def redraw_views(scene: bpy.types.Scene) -> None:
    """Have the views through the scene's camera drawn again."""
    for region, _ in camera_views(scene):
        region.tag_redraw()


def depsgraph_of(scene: bpy.types.Scene) -> bpy.types.Depsgraph:
    """The evaluated depsgraph of the first window that shows a scene; a timer has no context of its own."""
    window = next(each for each in bpy.context.window_manager.windows if each.scene == scene)
    with bpy.context.temp_override(window=window):
        return bpy.context.evaluated_depsgraph_get()


def _looks_through(space: bpy.types.SpaceView3D, view: bpy.types.RegionView3D, scene: bpy.types.Scene) -> bool:
    camera = space.camera if space.use_local_camera else scene.camera
    return (
        view.view_perspective == "CAMERA"
        and camera is not None
        and camera == scene.camera
        and camera.type == "CAMERA"  # Blender looks through any object
    )


def camera_frame(region: bpy.types.Region, view: bpy.types.RegionView3D, scene: bpy.types.Scene) -> Rectangle | None:
    """Where the whole camera frame lies in a view through it; None where it has no area."""
    # From the camera's own space, not over the world: far from the origin that would lose whole pixels.
    corners = np.array(scene.camera.data.view_frame(scene=scene), dtype=np.float64)
    projection = np.array(view.window_matrix, dtype=np.float64)
    clip = corners @ projection[:, :3].T + projection[:, 3]
    if clip[:, 3].min() <= 0.0:
        return None
    pixels = (clip[:, :2] / clip[:, 3:] + 1.0) / 2.0 * (region.width, region.height)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    width, height = (float(side) for side in high - low)
    return Rectangle(float(low[0]), float(low[1]), width, height) if width >= 1.0 and height >= 1.0 else None


def cropped(frame: Rectangle, image: ImageFormat) -> Rectangle:
    """The part of the camera's frame that an image shows: all of it unless a render border crops."""
    x, y = frame.width / image.full_width, frame.height / image.full_height
    bottom = image.full_height - image.top - image.height
    return Rectangle(frame.left + x * image.left, frame.bottom + y * bottom, x * image.width, y * image.height)


class Canvas:
    """The draw handler and what it shows."""

    def __init__(self) -> None:
        self.line = ""
        self.alert = False
        self._picture: Picture | None = None
        self._texture: gpu.types.GPUTexture | None = None
        self._shader: gpu.types.GPUShader | None = None
        self._handle: object | None = None
        self._scene = 0
        self._broken = False

    def on(self, scene: bpy.types.Scene) -> None:
        """Begin to draw in the views of a scene."""
        self.off()
        self._scene, self._broken = scene.session_uid, False
        self._handle = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", "POST_PIXEL")

    def off(self) -> None:
        """Draw no more, and forget the picture."""
        if self._handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
        self._handle = self._picture = self._texture = None
        self.line, self.alert = "", False

    @property
    def is_empty(self) -> bool:
        """Whether there is no picture to draw."""
        return self._picture is None

    @property
    def is_on(self) -> bool:
        """Whether Blender calls the draw handler."""
        return self._handle is not None

    def show(self, picture: Picture | None) -> None:
        """Take another picture, or none; it is seen with the next redraw."""
        self._picture, self._texture = picture, None

    def _draw(self) -> None:
        context = bpy.context
        scene, region, view = context.scene, context.region, context.region_data
        if scene.session_uid != self._scene or view is None or not _looks_through(context.space_data, view, scene):
            return
        frame = camera_frame(region, view, scene)
        if frame is None:
            return
        if self._picture is not None and not self._broken:
            try:
                self._draw_picture(cropped(frame, self._picture.image), self._picture, scene.chona.live_opacity)
            except Exception as error:  # the driver's, of any type; it would fail again with every redraw
                self._broken, self.alert = True, True
                self.line = f"This graphics card does not draw the preview: {' '.join(str(error).split())[:200]}"
        if self.line:
            self._draw_line(frame)

    def _draw_picture(self, place: Rectangle, picture: Picture, opacity: float) -> None:
        if self._shader is None:
            self._shader = _shader()
        if self._texture is None:
            height, width = picture.rgba.shape[:2]
            pixels = gpu.types.Buffer("FLOAT", (height, width, 4), picture.rgba)
            self._texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=pixels)
        left, bottom, right, top = place.left, place.bottom, place.left + place.width, place.bottom + place.height
        corners = {
            "pos": ((left, bottom), (right, bottom), (left, top), (right, top)),
            "uv": ((0.0, 1.0), (1.0, 1.0), (0.0, 0.0), (1.0, 0.0)),  # the picture's first row is its top
        }
        self._shader.uniform_float("opacity", opacity)
        self._shader.uniform_sampler("image", self._texture)
        gpu.state.blend_set("ALPHA_PREMULT")
        batch_for_shader(self._shader, "TRI_STRIP", corners).draw(self._shader)
        gpu.state.blend_set("NONE")

    def _draw_line(self, frame: Rectangle) -> None:
        scale = bpy.context.preferences.system.ui_scale
        blf.size(0, TEXT_SIZE * scale)
        blf.enable(0, blf.SHADOW)
        blf.shadow(0, 3, 0.0, 0.0, 0.0, 1.0)
        blf.color(0, *((1.0, 0.5, 0.4, 1.0) if self.alert else (1.0, 1.0, 1.0, 1.0)))
        margin = MARGIN * scale
        left, bottom = max(frame.left, 0.0) + margin, max(frame.bottom, 0.0) + margin
        if self.alert:  # a sentence: it is broken into lines, which go down from the top
            blf.enable(0, blf.WORD_WRAP)
            blf.word_wrap(0, max(int(frame.width - 2.0 * margin), 100))
            bottom = frame.bottom + frame.height - margin - TEXT_SIZE * scale
        blf.position(0, left, bottom, 0.0)
        blf.draw(0, self.line)
        blf.disable(0, blf.WORD_WRAP)
        blf.disable(0, blf.SHADOW)


def _shader() -> gpu.types.GPUShader:
    between = gpu.types.GPUStageInterfaceInfo("chona_live")
    between.smooth("VEC2", "at")
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant("MAT4", "ModelViewProjectionMatrix")
    info.push_constant("FLOAT", "opacity")
    info.sampler(0, "FLOAT_2D", "image")
    info.vertex_in(0, "VEC2", "pos")
    info.vertex_in(1, "VEC2", "uv")
    info.vertex_out(between)
    info.fragment_out(0, "VEC4", "colour")
    info.vertex_source(VERTEX)
    info.fragment_source(FRAGMENT)
    return gpu.shader.create_from_info(info)
