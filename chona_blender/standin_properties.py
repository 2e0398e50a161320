"""An actor's stand-in as the user sets it.

Blender reads the annotations of property classes, so they are not postponed here.
"""

import bpy

USES = (
    (
        "VIEWPORT",
        "Viewport",
        "Seen in the viewport alone: renders do not know of it",
        "RESTRICT_VIEW_OFF",
        0,
    ),
    (
        "SHADOW",
        "Shadows",
        "Rendered without being seen: it casts shadows and shows in mirrors, the camera looks through it",
        "LIGHT_AREA",
        1,
    ),
    (
        "HOLDOUT",
        "Holdout",
        "Cuts a hole into the picture, with alpha 0, for the baked figure to show through",
        "HOLDOUT_ON",
        2,
    ),
    ("VISIBLE", "Visible", "Rendered as any other mesh", "RESTRICT_RENDER_OFF", 3),
)


FOLLOWS = (
    (
        "RIG",
        "Rig",
        "An armature modifier on your rig: the mesh bends where the rig has its joints. For rigs with the figure's "
        "proportions",
    ),
    (
        "FIGURE",
        "Figure",
        "Through a hidden armature of the figure's own proportions that your rig moves: hands and feet come where a "
        "bake has them. For rigs of another body",
    ),
)


def _use_changed(self: "CHONA_PG_stand_in", _context: bpy.types.Context) -> None:
    for item in self.present():
        self.apply_use(item)


def _proxy_changed(self: "CHONA_PG_stand_in", _context: bpy.types.Context) -> None:
    for item in self.present():
        self.apply_proxy(item)


class CHONA_PG_stand_in_object(bpy.types.PropertyGroup):
    """One mesh of a stand-in."""

    name: bpy.props.StringProperty(name="Part", description="The person or object that it stands for")  # type: ignore[valid-type]
    object: bpy.props.PointerProperty(  # type: ignore[valid-type]
        name="Stand-In", description="The mesh object", type=bpy.types.Object
    )


class CHONA_PG_stand_in(bpy.types.PropertyGroup):
    """Meshes that stand in for a learned person and objects."""

    parts: bpy.props.CollectionProperty(  # type: ignore[valid-type]
        type=CHONA_PG_stand_in_object, name="Meshes", description="The mesh objects of the stand-in"
    )
    use: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="In Renders",
        description="What renders see of the stand-in",
        items=USES,
        default="VIEWPORT",
        update=_use_changed,
    )
    use_proxy: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Bounding Proxy",
        description="Show its bounding box instead of the mesh in the viewport; renders keep the mesh",
        update=_proxy_changed,
    )
    follow: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Follow",
        description="What moves the person's mesh; counts when the stand-in is made",
        items=FOLLOWS,
        default="RIG",
    )
    figure: bpy.props.PointerProperty(  # type: ignore[valid-type]
        name="Figure", description="The hidden armature of the figure's proportions", type=bpy.types.Object
    )
    voxel: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Detail",
        description="Edge of the voxels that the mesh is made from: smaller shows more and takes longer",
        subtype="DISTANCE",
        default=0.01,
        min=0.002,
        max=0.1,
        step=0.1,
        precision=3,
    )

    def present(self) -> list[bpy.types.Object]:
        """The mesh objects that are still in a collection of the file."""
        return [part.object for part in self.parts if part.object is not None and part.object.users_collection]

    def apply_use(self, item: bpy.types.Object) -> None:
        """Makes an object visible to renders as ``use`` says."""
        item.hide_render = self.use == "VIEWPORT"
        item.visible_camera = self.use != "SHADOW"
        item.is_holdout = self.use == "HOLDOUT"

    def apply_proxy(self, item: bpy.types.Object) -> None:
        """Draws an object in the viewport as ``use_proxy`` says."""
        item.display_type = "BOUNDS" if self.use_proxy else "TEXTURED"


CLASSES = (CHONA_PG_stand_in_object, CHONA_PG_stand_in)
