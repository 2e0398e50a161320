"""Which passes a bake writes: `scene.chona.passes`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

from collections.abc import Iterable

import bpy

from .errors import ChonaError

PASSES = ("combined", "depth", "mattes", "confidence", "normal", "cryptomatte")
"""Names that `chona bake --passes` knows, in the order of a frame's header; combined is always there."""


class CHONA_PG_passes(bpy.types.PropertyGroup):
    """Passes of baked frames, as a view layer has them."""

    depth: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Depth",
        description="Distance along the camera's view, which the compositor sorts the layer into the scene by",
        default=True,
    )
    mattes: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Mattes",
        description="How much of each pixel is a person (Human), and how much an object (Object)",
        default=True,
    )
    cryptomatte: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Cryptomatte",
        description="A matte of every person and every object of every actor, to be picked by name in a Cryptomatte "
        "node. The names are ACTOR.PERSON and ACTOR.OBJECT",
        default=True,
    )
    normal: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Normal",
        description="Which way surfaces face, in world space as Cycles' Normal pass has it. Models are vague about "
        "surfaces, so normals are smoothed over two centimeters",
        default=False,
    )
    confidence: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Confidence",
        description="How sure the model is of each pixel's pose: the share of what was looked at that it could place "
        "on the body",
        default=True,
    )

    def names(self) -> tuple[str, ...]:
        """The passes that are wanted, as the worker calls them."""
        return tuple(name for name in PASSES if name == "combined" or getattr(self, name))

    def choose(self, names: Iterable[str]) -> None:
        """Want these passes and no others; combined may be left out."""
        wanted = [name.strip() for name in names]
        for name in wanted:
            if name not in PASSES:
                raise ChonaError(f"there is no pass {name!r}; write some of {', '.join(PASSES)}, commas between")
        for name in PASSES[1:]:
            setattr(self, name, name in wanted)


CLASSES = (CHONA_PG_passes,)
