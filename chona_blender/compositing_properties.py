"""How baked frames are put into the compositor, as the user sets it: `scene.chona.composite`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

import bpy

DEPTH, REFINED = "DEPTH", "REFINED"
EDGES = (
    (
        DEPTH,
        "Depth",
        "In front or behind by the scene's depth, which has one value a pixel: exact but at edges of what is in front "
        "of the figure, where what is behind it may shine through",
    ),
    (
        REFINED,
        "Refined",
        "Renders what is in front of the figure once more in a view layer of its own, so that wires, hair and soft "
        "edges before the figure are right; costs the time to render what is in front",
    ),
)


def _is_mesh(_self: bpy.types.PropertyGroup, candidate: bpy.types.Object) -> bool:
    return candidate.type == "MESH"


class CHONA_PG_composite(bpy.types.PropertyGroup):
    """Options of Composite."""

    edges: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Edges",
        description="How pixels are composited that something in front of the figure covers in part",
        items=EDGES,
        default=DEPTH,
    )
    shadows: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Shadows",
        description="Let the figure's stand-ins cast its shadow and show in mirrors while the camera does not see them",
        default=False,
    )
    cryptomatte: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Cryptomatte",
        description="Add a Cryptomatte node on the baked frames where they have such a pass; the layer's own mattes "
        "are sockets of its node",
        default=True,
    )
    stand_in: bpy.props.PointerProperty(  # type: ignore[valid-type]
        name="Stand-In",
        description="A mesh in the figure's place; empty takes the actors' own stand-ins",
        type=bpy.types.Object,
        poll=_is_mesh,
    )


CLASSES = (CHONA_PG_composite,)
