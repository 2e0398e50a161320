"""What the settings and the command's options take along of a scene's blur."""

from __future__ import annotations

import bpy
from operation_scene import say

import chona_blender
from chona_blender.blur import scene_blur
from chona_blender.command_line import make_parser
from chona_blender.command_options import apply
from chona_blender.commands import RUNS
from chona_blender.errors import ChonaError

bpy.ops.wm.read_factory_settings(use_empty=True)
chona_blender.register()
scene = bpy.context.scene


def taken(*options: str, scene_blurs: bool = True, shutter: float = 0.5) -> dict | None:
    """What a bake with these options takes along."""
    scene.chona.property_unset("blur")
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = scene_blurs, shutter
    apply(scene, make_parser(RUNS).parse_args(["bake", *options]))
    blur = scene_blur(scene)
    return None if blur is None else {"times": len(blur.times), "lens": blur.lens, "samples": blur.samples}


answer = {
    "as the scene": taken(),
    "still scene": taken(scene_blurs=False),
    "on in a still scene": taken("--motion-blur", "on", scene_blurs=False),
    "motion off": taken("--motion-blur", "off"),
    "all off": taken("--motion-blur", "off", "--depth-of-field", "off"),
    "lens off, fewer": taken("--depth-of-field", "off", "--blur-samples", "5"),
    "closed shutter": taken("--depth-of-field", "off", shutter=0.01),
}
scene.render.motion_blur_shutter = 0.0
answer["no shutter"] = scene_blur(scene) is None
curve = scene.render.motion_blur_shutter_curve
for point in curve.curves[0].points:
    point.location.y = 0.0
curve.update()
scene.render.motion_blur_shutter = 0.5
try:
    scene_blur(scene)
except ChonaError as error:
    answer["dark"] = str(error)
panel = bpy.types.CHONA_PT_blur
answer["panel"] = [panel.bl_parent_id, sorted(panel.bl_options)]
say(answer)
