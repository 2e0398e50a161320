"""What of the scene's blur a bake takes along: `scene.chona.blur`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

import bpy


class CHONA_PG_blur(bpy.types.PropertyGroup):
    """Motion blur and depth of field of baked frames."""

    use_motion_blur: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Use Scene's Motion Blur",
        description="Where the scene renders with motion blur, blur what moves in baked frames alike: the same "
        "shutter, position and curve",
        default=True,
    )
    use_depth_of_field: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Use Camera's Depth of Field",
        description="Where the camera has depth of field, blur what is out of its focus in baked frames alike",
        default=True,
    )
    samples: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Samples",
        description="Rays a pixel of blurred frames: more are smoother and take longer",
        default=16,
        min=1,
        soft_max=128,
        max=1024,
    )


CLASSES = (CHONA_PG_blur,)
