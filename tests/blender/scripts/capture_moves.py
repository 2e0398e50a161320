"""Renders a moving square through the capture's colour and mask scenes; says where it is seen on each frame."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from operation_scene import emission_plane, empty_scene, say

from chona_blender.capture_render import colour_scene, mask_scene, read_png, render_still

folder = Path(sys.argv[1])
scene = empty_scene()
emission_plane("square", (0.5, 0.5), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
square = scene.objects["square"]
for frame, x in ((1, -1.0), (2, 0.0), (3, 1.0)):
    square.location.x = x
    square.keyframe_insert("location", frame=frame)
size = {"width": 64, "height": 32, "samples": 1, "device": "CPU"}
answer: dict = {"colour": [], "masks": [], "frame": scene.frame_current}
with colour_scene(scene, denoise=False, **size) as colour, mask_scene(scene, [square], [], **size) as masks:
    for frame in (1, 2, 3):
        for name, one in (("colour", colour), ("masks", masks)):
            one.frame_set(frame)
            path = folder / f"{name}.png"
            render_still(one, scene.camera, path)
            seen = read_png(path)[..., 0].astype(float)
            answer[name].append(float((seen * (np.arange(64) + 0.5)).sum() / seen.sum()))
answer["unmoved"] = scene.frame_current == answer["frame"] and len(bpy.data.scenes) == 1
say(answer)
