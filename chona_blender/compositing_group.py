"""The node group of one baked layer: an image sequence, put between what is in front of it and what is behind.

Blender's Z Combine multiplies premultiplied layers by their alpha a second time, so it is not used. With the picture
so far I, the layer F of alpha a, and Fr, what of I is in front of F in this pixel, of coverage c, all premultiplied:

    I (1 − a) + a Fr + (1 − c) F        (1)

is the picture with the layer in it, whatever mixture of things in front and behind the pixel holds. Where does Fr come
from? *Depth*: all or nothing, by the one depth that Blender keeps of a pixel. *Refined*: a view layer that shows what
is in front of the figure alone (compositing_front.py), used where it covers a pixel in part. An earlier layer that is
nearer is in front as well: with A its alpha and S the scene without layers, Fr = I − (1 − A)(S − front of S).
"""

from __future__ import annotations

import bpy

from .compositing_nodes import NodeMaker, show_frames
from .exr_header import ExrHeader
from .frames import BakedFrames

MARK = "chona"
FAR = 1e10
CONFLICT_PIXELS = 2
"""How far around a pixel, where the front view layer and depth contradict each other, depth alone decides."""
FULL, NONE = 0.999, 1e-5
"""Coverage that counts as a whole pixel and as none."""

_COLOUR, _VALUE, _VECTOR = "NodeSocketColor", "NodeSocketFloat", "NodeSocketVector"
INPUTS = (
    ("Image", _COLOUR, "The picture that the layer is put into"),
    ("Depth", _VALUE, "The scene's depth, metres along the camera's axis"),
    ("Front", _COLOUR, "What of the scene is in front of the figure, from the view layer that Composite made"),
    ("Scene", _COLOUR, "The picture before the first CHONA layer"),
    ("Layers Alpha", _VALUE, "Alpha of the CHONA layers before this one"),
    ("Layers Depth", _VALUE, "Depth of the CHONA layers before this one"),
)
OUTPUTS = (
    ("Image", _COLOUR, "The picture with the layer in it"),
    ("Depth", _VALUE, "The nearest of scene and layers, metres along the camera's axis"),
    ("Alpha", _VALUE, "Share of the pixel in which the layer is seen"),
    ("Human", _VALUE, "Share of the pixel in which people are seen"),
    ("Object", _VALUE, "Share of the pixel in which objects are seen"),
    ("Confidence", _VALUE, "Share of the layer's samples whose inverse skinning converged"),
    ("Normal", _VECTOR, "The layer's surface, world space, length 1; 0 where it is empty"),
    ("Layers Alpha", _VALUE, "Alpha of this CHONA layer and those before it"),
    ("Layers Depth", _VALUE, "Depth of this CHONA layer and those before it"),
)
SEEN_MATTES = ("Human", "Object")
PLAIN_PASSES = ("Confidence", "Normal")
CHANNEL = {"Human": "V", "Object": "V", "Confidence": "V", "Normal": "X"}


def fill_group(group: bpy.types.NodeTree, frames: BakedFrames, header: ExrHeader, refined: bool) -> tuple[str, ...]:
    """Make the group show `frames`, whose first file has `header`. Sockets that stay keep their links.

    Returns the names of outputs that had to go since the frames have no such pass any more.
    """
    layer = header.layers[0]
    passes = {name for name, letter in CHANNEL.items() if f"{layer}.{name}.{letter}" in header.channels}
    _sockets(group, "INPUT", [item for item in INPUTS if refined or item[0] != "Front"])
    gone = _sockets(group, "OUTPUT", [item for item in OUTPUTS if item[0] not in CHANNEL or item[0] in passes])
    old = {node.image for node in group.nodes if node.bl_idname == "CompositorNodeImage" and node.image is not None}
    group.nodes.clear()
    _build(group, _sequence_image(group, frames, old), layer, (frames.numbers[0], frames.numbers[-1]), refined)
    return gone


def _build(group: bpy.types.NodeTree, image: bpy.types.Image, layer: str, span: tuple[int, int], refined: bool) -> None:
    make = NodeMaker(group)
    given = make.node("NodeGroupInput", -4, 1).outputs
    results = make.node("NodeGroupOutput", 6, 0).inputs
    source = make.node("CompositorNodeImage", -4, -1)
    source.image = image
    source.layer = layer
    show_frames(source, *span)
    sockets = {socket.name: socket for socket in source.outputs}
    figure, depth = sockets["Combined"], sockets["Depth"]
    figure_alpha = make.alpha(figure, at=(-3, -1))
    layers_alpha = given["Layers Alpha"]

    picture_alpha = make.alpha(given["Image"], at=(-3, 7))

    by_depth = make.math("LESS_THAN", depth, given["Depth"], at=(-3, 0))
    nearer_layer = make.math("LESS_THAN", given["Layers Depth"], depth, at=(-3, 1))
    black = make.node("CompositorNodeRGB", -2, 2).outputs[0]
    black.default_value = (0.0, 0.0, 0.0, 0.0)
    front, front_alpha, visible = black, 0.0, by_depth
    if refined:
        believed, coverage = _front(make, given["Front"], by_depth)
        front = make.blend("MIX", believed, black, given["Front"], at=(-2, 3))
        front_alpha = make.math("MULTIPLY", believed, coverage, at=(-1, 7))
        visible = make.math("MAXIMUM", by_depth, believed, at=(-1, 0))

    # What is in front of the figure when an earlier layer is: I − (1 − A)(S − front), then its alpha alike.
    share = make.math("SUBTRACT", 1.0, layers_alpha, at=(-1, 2))
    behind = make.blend("SUBTRACT", 1.0, given["Scene"], front, at=(-1, 3))
    layers_front = make.blend("SUBTRACT", share, given["Image"], behind, at=(0, 2))
    behind_alpha = make.math("SUBTRACT", make.alpha(given["Scene"], at=(-2, 8)), front_alpha, at=(-1, 8))
    lost = make.math("MULTIPLY", share, behind_alpha, at=(0, 8))
    layers_front_alpha = make.math("SUBTRACT", picture_alpha, lost, at=(1, 8))

    covered = _select(make, nearer_layer, front_alpha, layers_front_alpha, at=(2, 8))
    covering = make.with_alpha(make.blend("MIX", nearer_layer, front, layers_front, at=(1, 2)), covered, at=(2, 2))

    # (1) as one Mix: a Fr + (1 − c) F = a (Fr over F / a). The alpha is the same in front of and behind the scene.
    opaque = make.with_alpha(make.straight(figure, at=(0, -2)), 1.0, at=(1, -2))
    inserted = make.blend("MIX", figure_alpha, given["Image"], make.over(opaque, covering, at=(2, -1)), at=(3, -1))
    seen_through = make.over(figure, given["Image"], at=(2, 0))
    result = make.blend("MIX", visible, seen_through, inserted, at=(4, -1))
    make.feed(make.with_alpha(result, _union(make, figure_alpha, picture_alpha, row=6), at=(5, -1)), results["Image"])

    nearest = make.math("MINIMUM", given["Layers Depth"], depth, at=(0, 5))
    make.feed(make.math("MINIMUM", nearest, given["Depth"], at=(1, 5)), results["Depth"])
    make.feed(nearest, results["Layers Depth"])
    make.feed(_union(make, figure_alpha, layers_alpha, row=7), results["Layers Alpha"])

    uncovered = make.math("SUBTRACT", 1.0, covered, at=(3, 2))
    transparency = make.math("SUBTRACT", 1.0, picture_alpha, at=(3, 3))
    seen = _select(make, visible, transparency, uncovered, at=(4, 2))
    make.feed(make.math("MULTIPLY", figure_alpha, seen, at=(5, 2)), results["Alpha"])
    for row, name in enumerate(SEEN_MATTES):
        if name in sockets and name in results:
            make.feed(make.math("MULTIPLY", sockets[name], seen, at=(5, 3 + row)), results[name])
    for name in PLAIN_PASSES:
        if name in sockets and name in results:
            make.feed(sockets[name], results[name])


def _front(
    make: NodeMaker, front: bpy.types.NodeSocket, by_depth: bpy.types.NodeSocket
) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Where the front view layer is to be believed, which is where it covers a pixel in part; and its coverage.

    Pixels that are covered as a whole or not at all are what depth can tell, and it knows the figure's true surface.
    Beside a pixel where both contradict each other, what seems to be in front is behind the figure's surface.
    """
    coverage = make.alpha(front, at=(-3, 3))
    full = make.math("GREATER_THAN", coverage, FULL, at=(-3, 4))
    some = make.math("GREATER_THAN", coverage, NONE, at=(-3, 5))
    in_part = make.math("SUBTRACT", some, full, at=(-2, 4))
    contradicted = make.dilate(make.math("MULTIPLY", full, by_depth, at=(-2, 5)), CONFLICT_PIXELS, at=(-1, 5))
    believed = make.math("MULTIPLY", in_part, make.math("SUBTRACT", 1.0, contradicted, at=(-1, 6)), at=(-1, 4))
    return believed, coverage


def _select(
    make: NodeMaker,
    factor: bpy.types.NodeSocket,
    without: bpy.types.NodeSocket | float,
    with_it: bpy.types.NodeSocket,
    at: tuple[int, int],
) -> bpy.types.NodeSocket:
    """Numbers as Mix does colours."""
    column, row = at
    difference = make.math("SUBTRACT", with_it, without, at=at)
    return make.math("MULTIPLY_ADD", factor, difference, without, at=(column, row + 1))


def _union(
    make: NodeMaker, first: bpy.types.NodeSocket, second: bpy.types.NodeSocket, row: int
) -> bpy.types.NodeSocket:
    """Alpha of one picture over another."""
    either = make.math("ADD", first, second, at=(3, row))
    both = make.math("MULTIPLY", first, second, at=(4, row))
    return make.math("SUBTRACT", either, both, at=(5, row))


def _sockets(group: bpy.types.NodeTree, side: str, wanted: list[tuple[str, str, str]]) -> tuple[str, ...]:
    """Give the group's interface exactly these sockets on one side, in order; the names of those that went."""
    interface = group.interface
    present = {item.name: item for item in interface.items_tree if item.item_type == "SOCKET" and item.in_out == side}
    names = [name for name, _, _ in wanted]
    gone = tuple(name for name in present if name not in names)
    for name in gone:
        interface.remove(present[name])
    for name, kind, description in wanted:
        item = present.get(name) or interface.new_socket(name=name, in_out=side, socket_type=kind)
        item.description = description
        if side == "INPUT" and kind == _VALUE:
            item.default_value = 0.0 if name == "Layers Alpha" else FAR
            item.hide_value = True
        elif side == "INPUT":
            item.default_value = (0.0, 0.0, 0.0, 0.0)
            item.hide_value = True
    return gone


def _sequence_image(group: bpy.types.NodeTree, frames: BakedFrames, old: set[bpy.types.Image]) -> bpy.types.Image:
    """The sequence's image: the one that the group had, or a new one."""
    path = frames.path(frames.numbers[0])
    image = next(iter(old), None)
    if image is None:
        image = bpy.data.images.load(str(path), check_existing=False)
        image.name = group.name
    image.filepath = _stored_path(str(path))
    image.source = "SEQUENCE"
    names = image.colorspace_settings.bl_rna.properties["name"].enum_items.keys()
    if "Linear Rec.709" in names:
        # Never Non-Color: with another working space the colours have to be converted and depth must not be.
        image.colorspace_settings.name = "Linear Rec.709"
    image.reload()
    return image


def _stored_path(path: str) -> str:
    """Relative to the .blend file where the user wants it so and it can be."""
    if not bpy.data.filepath or not bpy.context.preferences.filepaths.use_relative_paths:
        return path
    try:
        return bpy.path.relpath(path)
    except ValueError:  # another drive on Windows
        return path


def sequence_image(group: bpy.types.NodeTree) -> bpy.types.Image | None:
    """The image sequence that the group shows."""
    return next((node.image for node in group.nodes if node.bl_idname == "CompositorNodeImage"), None)
