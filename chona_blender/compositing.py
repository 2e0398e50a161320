"""Puts baked frames into the scene's compositor by depth, and takes them out again without a trace.

One node group `CHONA <name>` is inserted in the link that ends in the tree's output; further layers stack behind it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import bpy

from . import compositing_front as front
from . import compositing_shadow as shadow
from .camera import image_format
from .compositing_front import Figure
from .compositing_group import MARK, fill_group, sequence_image
from .compositing_nodes import show_frames
from .compositing_state import STATE, has_state, prepare, restore, switch_depth_on
from .compositing_tree import (
    RENDER_LAYERS,
    bypass,
    connect,
    current_tree,
    depth_sources,
    find_layer,
    insert,
    is_layer_node,
    mark,
    own_node,
    remove_own_nodes,
)
from .errors import ChonaError
from .exr_header import ExrHeader, read_exr_header
from .frames import BakedFrames, describe_frames, find_baked_frames

__all__ = ["STATE", "CompositeOptions", "CompositeResult", "Figure", "add_layer", "current_tree", "has_layers",
           "layer_group_name", "layer_names", "remove_layer", "size_words"]  # fmt: skip

CRYPTOMATTE = "CompositorNodeCryptomatteV2"
SIZE = "chona_size"
NO_FIGURE = (
    "needs to know where the figure is: set the actor's armature or object, or choose a stand-in under "
    "3D Viewport > Sidebar > CHONA > Composite"
)


@dataclass(frozen=True)
class CompositeOptions:
    """How a layer is put in.

    Attributes:
        refined: edges by a view layer of what is in front of the figure, instead of by depth alone.
        shadows: the figure's stand-ins cast its shadow and show in mirrors.
        cryptomatte: a Cryptomatte node on the same frames, where they have such a pass.
        figure: where the figure is; needed by the first two.
    """

    refined: bool = False
    shadows: bool = False
    cryptomatte: bool = True
    figure: Figure | None = None


@dataclass(frozen=True)
class CompositeResult:
    """What was built, in words for a report."""

    group: bpy.types.NodeTree
    frames: BakedFrames
    warnings: tuple[str, ...]

    @property
    def message(self) -> str:
        return f"{self.group.name}: {describe_frames(self.frames.numbers)}"


def layer_group_name(name: str) -> str:
    """The node group's name for the bake `name`."""
    return f"CHONA {name}"


def add_layer(
    scene: bpy.types.Scene, folder: Path, name: str, options: CompositeOptions | None = None
) -> CompositeResult:
    """Make or update the layer that shows the bake `name` of `folder` in the scene.

    Raises:
        ChonaError: there are no frames that fit, or the scene cannot be changed. Then nothing was.
    """
    options = options or CompositeOptions()
    frames, header = _checked_frames(scene, folder, name)
    figure = _checked_figure(scene, options)
    fresh = not has_state(scene)
    tree = prepare(scene)
    node = find_layer(tree, name)
    made = node is None
    try:
        if made:
            _free_orphans(name)
            group = bpy.data.node_groups.new(layer_group_name(name), "CompositorNodeTree")
        else:
            group = node.node_tree
        gone = fill_group(group, frames, header, options.refined)
        group[MARK], group[SIZE] = name, (header.width, header.height)
        if made:
            node = insert(tree, group)
        sources = depth_sources(scene, tree)
        view_layers = [scene.view_layers[source.layer] for source in sources]
        for view_layer in view_layers:
            switch_depth_on(scene, view_layer)
        connect(tree, node, sources)
        if options.refined:
            _link_front(tree, node, front.make_front(scene, name, view_layers[0], figure), scene)
        else:
            _remove_front(scene, tree, name)
        stand_ins = figure.stand_ins if options.shadows and figure is not None else ()
        shadow.stop_shadows(name, staying=stand_ins)
        shadow.cast_shadows(stand_ins, name)
        _cryptomatte(tree, node, frames, header, options.cryptomatte)
    except (ChonaError, RuntimeError, KeyError) as error:
        if made:
            remove_layer(scene, name)
            _free_orphans(name)
            if fresh:
                restore(scene)
        if isinstance(error, ChonaError):
            raise
        raise ChonaError(f"the layer could not be put into the compositor tree {tree.name}: {error}") from error
    return CompositeResult(group, frames, (*_frame_warnings(frames), *_output_warnings(gone)))


def remove_layer(scene: bpy.types.Scene, name: str) -> bool:
    """Take the layer out; True when there was one."""
    tree = current_tree(scene)
    node = None if tree is None else find_layer(tree, name)
    if tree is None or node is None:
        left_over = has_layers(scene) and not layer_names(scene)  # the user has deleted the node by hand
        if left_over:
            _remove_helpers(scene, tree, name)
            restore(scene)
        return left_over
    group = node.node_tree
    bypass(tree, node)
    tree.nodes.remove(node)
    _remove_helpers(scene, tree, name)
    _free(group)
    if not layer_names(scene):
        restore(scene)
    return True


def layer_names(scene: bpy.types.Scene) -> list[str]:
    """The bakes whose layers are in the scene's compositor."""
    tree = current_tree(scene)
    if tree is None:
        return []
    return [node.node_tree[MARK] for node in tree.nodes if is_layer_node(node)]


def has_layers(scene: bpy.types.Scene) -> bool:
    """Whether a layer is in the scene's compositor; quick enough for poll and draw."""
    return has_state(scene)


def size_words(scene: bpy.types.Scene, name: str) -> str:
    """What is wrong with a layer's size, or nothing; quick enough for draw."""
    tree = current_tree(scene)
    node = None if tree is None else find_layer(tree, name)
    render = scene.render
    if node is None or SIZE not in node.node_tree or (render.use_border and render.use_crop_to_border):
        return ""
    width, height = node.node_tree[SIZE]
    image = image_format(scene)
    if (image.width, image.height) == (width, height):
        return ""
    return f"Baked at {width} × {height}, the scene renders {image.width} × {image.height}"


def _checked_frames(scene: bpy.types.Scene, folder: Path, name: str) -> tuple[BakedFrames, ExrHeader]:
    frames = find_baked_frames(folder, name)
    if not frames.numbers:
        raise ChonaError(
            f"{name} has only frames below 0 and Blender's image sequences begin at 0; "
            "move the animation to frame 0 or later and bake it again"
        )
    first = frames.path(frames.numbers[0])
    header = read_exr_header(first)
    image = image_format(scene)
    size = (image.width, image.height)
    if (header.width, header.height) != size:
        raise ChonaError(
            f"{name} was baked at {header.width} × {header.height} but the scene renders {size[0]} × {size[1]}; "
            "the compositor does not scale layers: bake again, or set the render resolution back"
        )
    if not header.layers:
        raise ChonaError(f"{first} has no layer with a Combined pass; expected a frame that CHONA baked")
    if f"{header.layers[0]}.Depth.Z" not in header.channels:
        raise ChonaError(
            f"{name} was baked without the pass 'depth', by which the compositor tells what is in front; bake it again "
            "with it (--passes combined,depth,mattes,confidence)"
        )
    return frames, header


def _checked_figure(scene: bpy.types.Scene, options: CompositeOptions) -> Figure | None:
    figure = options.figure
    if options.refined and figure is None:
        raise ChonaError(f"Edges: Refined {NO_FIGURE}; or composite with Edges: Depth")
    if options.refined:
        front.only_camera(scene)
    if options.shadows and (figure is None or not figure.stand_ins):
        raise ChonaError(
            "Shadows need a stand-in of the figure, which casts them: make one (Stand-In panel), or choose any mesh "
            "under 3D Viewport > Sidebar > CHONA > Composite"
        )
    return figure


def _link_front(
    tree: bpy.types.NodeTree, node: bpy.types.Node, view_layer: bpy.types.ViewLayer, scene: bpy.types.Scene
) -> None:
    name = node.node_tree[MARK]
    source = own_node(tree, RENDER_LAYERS, name) or mark(tree.nodes.new(RENDER_LAYERS), name)
    source.scene, source.layer = scene, view_layer.name
    source.label = view_layer.name
    source.location = (node.location.x - 320.0, node.location.y - 300.0)
    tree.links.new(source.outputs["Image"], node.inputs["Front"])


def _remove_front(scene: bpy.types.Scene, tree: bpy.types.NodeTree, name: str) -> None:
    source = own_node(tree, RENDER_LAYERS, name)
    if source is not None:
        tree.nodes.remove(source)
    front.remove_front(scene, name)


def _cryptomatte(
    tree: bpy.types.NodeTree, node: bpy.types.Node, frames: BakedFrames, header: ExrHeader, wanted: bool
) -> None:
    """A Cryptomatte node beside the layer, on the same frames; what the user picked in it stays."""
    name = node.node_tree[MARK]
    matte = own_node(tree, CRYPTOMATTE, name)
    if not wanted or not _crypto_names(header):
        if matte is not None:
            tree.nodes.remove(matte)
        return
    if matte is None:
        matte = mark(tree.nodes.new(CRYPTOMATTE), name)
        matte.source = "IMAGE"
        matte.label = f"{node.node_tree.name} Cryptomatte"
        matte.location = (node.location.x, node.location.y - 520.0)
        tree.links.new(node.outputs["Image"], matte.inputs["Image"])
        matte.image = sequence_image(node.node_tree)
        matte.matte_id = next((entry for entry in _crypto_names(header) if "," not in entry), "")
    matte.image = sequence_image(node.node_tree)
    show_frames(matte, frames.numbers[0], frames.numbers[-1])


def _crypto_names(header: ExrHeader) -> list[str]:
    """What the frames' Cryptomatte tells apart."""
    manifests = [
        text for key, text in header.strings.items() if key.startswith("cryptomatte/") and key.endswith("/manifest")
    ]
    return [entry for text in manifests for entry in json.loads(text)]


def _remove_helpers(scene: bpy.types.Scene, tree: bpy.types.NodeTree | None, name: str) -> None:
    """Everything beside the layer's own node."""
    if tree is not None:
        remove_own_nodes(tree, name)
    front.remove_front(scene, name)
    shadow.stop_shadows(name)


def _frame_warnings(frames: BakedFrames) -> tuple[str, ...]:
    words = []
    if frames.missing:
        count = len(frames.missing)
        are = "1 frame is missing" if count == 1 else f"{count} frames are missing"
        words.append(f"{are} between {frames.numbers[0]} and {frames.numbers[-1]} and will be empty")
    if frames.negative:
        words.append(f"{len(frames.negative)} frames below 0 are left out: Blender's image sequences begin at 0")
    return tuple(words)


def _output_warnings(gone: tuple[str, ...]) -> tuple[str, ...]:
    if not gone:
        return ()
    return (f"the frames have no {', '.join(gone)} any more: what was linked to it is not",)


def _free_orphans(name: str) -> None:
    """Groups of this bake whose node the user has deleted by hand: nothing shows them any more."""
    for group in list(bpy.data.node_groups):
        if group.users == 0 and group.get(MARK) == name:
            _free(group)


def _free(group: bpy.types.NodeTree) -> None:
    """Remove the group and its image when nothing else uses them."""
    if group.users:
        return
    image = sequence_image(group)
    bpy.data.node_groups.remove(group)
    if image is not None and image.users == 0:
        bpy.data.images.remove(image)
