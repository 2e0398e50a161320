"""Renders the images of a capture from temporary scenes: colour with the scene's own light, and masks.

The colour scene is a copy of the user's (same light, same materials).  The mask scene holds its visible objects without
lights, under one emitting override material that paints the person red and the object green by their pass index, so
one fast render gives both visible parts, each hidden by the other and by the furniture.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import bpy
import numpy as np
from bpy.types import LayerCollection, Material, Object, Scene

from .errors import ChonaError

PERSON_INDEX, OBJECT_INDEX = 1, 2
_SWITCHED_OFF = (
    "use_border", "use_crop_to_border", "use_motion_blur", "use_compositing", "use_sequencer", "use_stamp",
    "use_multiview", "use_freestyle", "film_transparent", "use_placeholder", "use_file_extension",
)  # fmt: skip
_WITHOUT_SURFACE = {"LIGHT", "LIGHT_PROBE", "VOLUME", "CAMERA", "SPEAKER"}


def visible_objects(scene: Scene) -> list[Object]:
    """Objects that the scene's first view layer renders (instances apart)."""

    def walk(layer: LayerCollection) -> Iterator[Object]:
        if layer.exclude or layer.collection.hide_render or layer.indirect_only:
            return
        yield from layer.collection.objects
        for child in layer.children:
            yield from walk(child)

    root = scene.view_layers[0].layer_collection
    return [each for each in dict.fromkeys(walk(root)) if not each.hide_render]


def _use_cycles(scene: Scene, device: str, samples: int, denoise: bool) -> None:
    try:
        scene.render.engine = "CYCLES"
    except TypeError:
        raise ChonaError("Captures are rendered with Cycles, which is switched off. Enable the add-on Cycles") from None
    scene.cycles.device = device
    scene.cycles.samples = samples
    scene.cycles.use_denoising = denoise
    scene.cycles.seed = 0


def _use_png(scene: Scene, width: int, height: int, view_transform: str) -> None:
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    for name in _SWITCHED_OFF:
        if hasattr(render, name):
            setattr(render, name, False)
    render.use_overwrite, render.dither_intensity = True, 0.0
    settings = render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGB", "8"
    settings.color_management = "FOLLOW_SCENE"
    scene.display_settings.display_device = "sRGB"
    view = scene.view_settings
    view.view_transform, view.look = view_transform, "None"
    view.exposure, view.gamma, view.use_curve_mapping = 0.0, 1.0, False
    if hasattr(view, "use_white_balance"):
        view.use_white_balance = False


@contextmanager
def colour_scene(
    scene: Scene,
    *,
    width: int,
    height: int,
    samples: int,
    denoise: bool,
    device: str,
    only: Sequence[Object] | None = None,
) -> Iterator[Scene]:
    """A copy of ``scene`` that renders colour images; removed afterwards.

    Args:
        only: hides everything but these objects and the lights.
    """
    copy = scene.copy()
    try:
        copy.name = "CHONA colour"
        if only is not None:
            kept = [*only, *(each for each in visible_objects(scene) if each.type in {"LIGHT", "LIGHT_PROBE"})]
            for child in list(copy.collection.children):
                copy.collection.children.unlink(child)
            for each in list(copy.collection.objects):
                copy.collection.objects.unlink(each)
            for each in dict.fromkeys(kept):
                copy.collection.objects.link(each)
        for index, layer in enumerate(copy.view_layers):
            layer.use = index == 0
        _use_cycles(copy, device, samples, denoise)
        _use_png(copy, width, height, "Standard")
        yield copy
    finally:
        bpy.data.scenes.remove(copy)


def _mask_material() -> Material:
    material = bpy.data.materials.new("CHONA masks")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    info = tree.nodes.new("ShaderNodeObjectInfo")
    combine = tree.nodes.new("ShaderNodeCombineColor")
    for channel, index in enumerate((PERSON_INDEX, OBJECT_INDEX)):
        compare = tree.nodes.new("ShaderNodeMath")
        compare.operation = "COMPARE"
        compare.inputs[1].default_value = float(index)
        compare.inputs[2].default_value = 0.5
        tree.links.new(info.outputs["Object Index"], compare.inputs[0])
        tree.links.new(compare.outputs[0], combine.inputs[channel])
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(combine.outputs[0], emission.inputs["Color"])
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    material.cycles.emission_sampling = "NONE"
    return material


@contextmanager
def _pass_indices(everything: Sequence[Object], person: Sequence[Object], things: Sequence[Object]) -> Iterator[None]:
    """Numbers the objects for the mask material and puts the user's numbers back."""
    before = {each: each.pass_index for each in dict.fromkeys([*everything, *person, *things])}
    try:
        for each in before:
            each.pass_index = 0
        for each in person:
            each.pass_index = PERSON_INDEX
        for each in things:
            each.pass_index = OBJECT_INDEX
        yield
    finally:
        for each, index in before.items():
            each.pass_index = index


@contextmanager
def mask_scene(
    scene: Scene,
    person: Sequence[Object],
    things: Sequence[Object],
    *,
    width: int,
    height: int,
    samples: int,
    device: str,
    only: Sequence[Object] | None = None,
) -> Iterator[Scene]:
    """A scene that renders the person's visible part in red and the object's in green; removed afterwards."""
    shown = [each for each in (visible_objects(scene) if only is None else only) if each.type not in _WITHOUT_SURFACE]
    with ExitStack() as stack:
        stack.enter_context(_pass_indices(shown, person, things))
        material = _mask_material()
        stack.callback(bpy.data.materials.remove, material)
        masks = bpy.data.scenes.new("CHONA masks")
        stack.callback(bpy.data.scenes.remove, masks)
        for each in shown:
            masks.collection.objects.link(each)
        for name in ("fps", "fps_base", "frame_map_old", "frame_map_new"):
            setattr(masks.render, name, getattr(scene.render, name))
        masks.view_layers[0].material_override = material
        _use_cycles(masks, device, samples, denoise=False)
        _use_png(masks, width, height, "Raw")
        cycles = masks.cycles
        cycles.use_adaptive_sampling = False
        cycles.max_bounces = cycles.transparent_max_bounces = 0
        cycles.pixel_filter_type, cycles.filter_width = scene.cycles.pixel_filter_type, scene.cycles.filter_width
        yield masks


@contextmanager
def no_depth_of_field(cameras: Sequence[Object]) -> Iterator[None]:
    """Switches the cameras' depth of field off: the model's cameras are pinholes."""
    before = {each.data: each.data.dof.use_dof for each in cameras}
    try:
        for data in before:
            data.dof.use_dof = False
        yield
    finally:
        for data, value in before.items():
            data.dof.use_dof = value


def render_still(scene: Scene, camera: Object, path: Path) -> None:
    """Renders the scene's current frame to ``path``.

    Raises:
        ChonaError: Blender wrote no image.
    """
    scene.camera = camera
    scene.render.filepath = str(path)
    # The operator's own argument `scene` renders another scene than the window's without moving it to its frame.
    with bpy.context.temp_override(scene=scene):
        bpy.ops.render.render(write_still=True)
    if not path.exists():
        raise ChonaError(
            f"Blender rendered camera '{camera.name}' but wrote no '{path.name}'. Look for its message in the console"
        )


def read_png(path: Path) -> np.ndarray:
    """[height, width, 4] uint8 of an image file, the top row first, values as stored."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        flat = np.empty(width * height * 4, dtype=np.float32)
        image.pixels.foreach_get(flat)
    finally:
        bpy.data.images.remove(image)
    return np.rint(flat.reshape(height, width, 4)[::-1] * 255.0).astype(np.uint8)


def write_grey_png(path: Path, grey: np.ndarray) -> None:
    """Writes [height, width] uint8 as a grey PNG."""
    height, width = grey.shape

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = np.concatenate([np.zeros((height, 1), dtype=np.uint8), grey], axis=1)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6))
        + chunk(b"IEND", b"")
    )
