"""Compositor nodes in the words that the layer's graph is written in; what differs between versions stays in here."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

NEW = bpy.app.version >= (5, 0, 0)
"""Options that were properties of a node in 4.5 are menu sockets."""


@dataclass(frozen=True)
class NodeMaker:
    """Makes nodes in one tree. Values are a socket to link from, or a number."""

    tree: bpy.types.NodeTree

    def node(self, kind: str, column: int, row: int) -> bpy.types.Node:
        """A node in a place of a grid that reads from left to right."""
        made = self.tree.nodes.new(kind)
        made.location = (220.0 * column, -180.0 * row)
        return made

    def feed(self, value: bpy.types.NodeSocket | float, socket: bpy.types.NodeSocket) -> None:
        """Link or set an input."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def math(self, operation: str, *values: bpy.types.NodeSocket | float, at: tuple[int, int]) -> bpy.types.NodeSocket:
        """`ShaderNodeMath` of two or three values."""
        made = self.node("ShaderNodeMath", *at)
        made.operation = operation
        for value, socket in zip(values, made.inputs, strict=False):
            self.feed(value, socket)
        return made.outputs[0]

    def blend(
        self,
        kind: str,
        factor: bpy.types.NodeSocket | float,
        first: bpy.types.NodeSocket,
        second: bpy.types.NodeSocket,
        at: tuple[int, int],
    ) -> bpy.types.NodeSocket:
        """`ShaderNodeMix` of two colours. Its alpha is not to be used: 4.5 keeps the first one's, 5.0 mixes them."""
        made = self.node("ShaderNodeMix", *at)
        made.data_type, made.blend_type = "RGBA", kind
        sockets = {socket.identifier: socket for socket in made.inputs}
        self.feed(factor, sockets["Factor_Float"])
        self.feed(first, sockets["A_Color"])
        self.feed(second, sockets["B_Color"])
        return next(socket for socket in made.outputs if socket.identifier == "Result_Color")

    def over(
        self, background: bpy.types.NodeSocket, foreground: bpy.types.NodeSocket, at: tuple[int, int]
    ) -> bpy.types.NodeSocket:
        """Alpha Over of premultiplied pictures."""
        made = self.node("CompositorNodeAlphaOver", *at)
        colours = [socket for socket in made.inputs if socket.type == "RGBA"]  # names differ between 4.5 and 5
        self.feed(background, colours[0])
        self.feed(foreground, colours[1])
        return made.outputs["Image"]

    def with_alpha(
        self, picture: bpy.types.NodeSocket, alpha: bpy.types.NodeSocket | float, at: tuple[int, int]
    ) -> bpy.types.NodeSocket:
        """The same colours with another alpha."""
        made = self.node("CompositorNodeSetAlpha", *at)
        if NEW:
            made.inputs["Type"].default_value = "Replace Alpha"
        else:
            made.mode = "REPLACE_ALPHA"
        self.feed(picture, made.inputs["Image"])
        self.feed(alpha, made.inputs["Alpha"])
        return made.outputs["Image"]

    def straight(self, picture: bpy.types.NodeSocket, at: tuple[int, int]) -> bpy.types.NodeSocket:
        """Colours divided by alpha."""
        made = self.node("CompositorNodePremulKey", *at)
        if NEW:
            made.inputs["Type"].default_value = "To Straight"
        else:
            made.mapping = "PREMUL_TO_STRAIGHT"
        self.feed(picture, made.inputs["Image"])
        return made.outputs["Image"]

    def alpha(self, picture: bpy.types.NodeSocket, at: tuple[int, int]) -> bpy.types.NodeSocket:
        """The picture's alpha."""
        made = self.node("CompositorNodeSeparateColor", *at)
        self.feed(picture, made.inputs["Image"])
        return made.outputs["Alpha"]

    def dilate(self, mask: bpy.types.NodeSocket, pixels: int, at: tuple[int, int]) -> bpy.types.NodeSocket:
        """The mask grown by a number of pixels."""
        made = self.node("CompositorNodeDilateErode", *at)
        self.feed(mask, made.inputs["Mask"])
        made.inputs["Size"].default_value = pixels
        return made.outputs["Mask"]


def show_frames(node: bpy.types.Node, first: int, last: int) -> None:
    """Let an Image or Cryptomatte node show file N in frame N from `first` to `last`, and nothing in others."""
    node.frame_start = first
    node.frame_offset = first - 1
    # One more than there are: the frame behind the last has no file and stays empty, where Blender would hold the last
    # picture.
    node.frame_duration = last - first + 2
    node.use_cyclic = False
    node.use_auto_refresh = True
