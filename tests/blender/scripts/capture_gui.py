"""Runs inside the real Blender with a window: a capture's cameras, its estimate and the capture; numbered pictures.

Not collected by pytest. `blender --python-use-system-env --python capture_gui.py -- ZIP FOLDER`, the repository and
this folder on $PYTHONPATH; ZIP is the built extension, and the character is the demo's.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
from window import Drive, call, module, show_only, show_sidebar, until, view_area

from demo.animate import key_performance
from demo.character import build_character
from demo.crate import build_crate
from demo.poses import TRAINED, performance

package, out = (Path(part) for part in sys.argv[sys.argv.index("--") + 1 :][:2])
drive = Drive(out, {"version": list(bpy.app.version)})
answer = drive.answer
SHOWN = {"CHONA_PT_capture", "CHONA_PT_capture_cameras", "CHONA_PT_capture_start"}


def until_idle(seconds: float) -> Iterator[float]:
    """Wait for the running job."""
    yield from until(lambda: module("jobs").running() is None, seconds)


def story() -> Iterator[float]:
    """What an animator does."""
    bpy.ops.extensions.package_install_files(filepath=str(package), repo="user_default", enable_on_install=True)
    show_only(module("panels"), SHOWN)
    learn = module("panels.learn")
    for cls in reversed(learn.CLASSES):
        bpy.utils.unregister_class(cls)
    learn.CHONA_PT_capture.bl_options = set()  # open, for the pictures
    for cls in learn.CLASSES:
        bpy.utils.register_class(cls)
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    scene = bpy.context.scene
    armature, _body = build_character(scene.collection)
    carrier, _crate = build_crate(scene.collection)
    key_performance(armature, carrier, performance(TRAINED[0]), range(1, 11))
    scene.frame_end = 10
    space = view_area().spaces.active
    space.shading.type, space.shading.color_type = "SOLID", "TEXTURE"
    space.region_3d.view_location, space.region_3d.view_distance = (0.9, 0.0, 0.9), 9.5
    space.region_3d.view_rotation = (0.78, 0.58, 0.13, 0.18)
    yield from show_sidebar()
    settings = scene.chona
    yield from drive.picture("nothing")
    settings.capture_armature, settings.capture_object = armature, carrier
    answer["shown"] = call("chona.show_ring", "INVOKE_DEFAULT")
    yield from drive.picture("one_ring")
    settings.capture_rings, settings.capture_cameras, settings.capture_ring_height = 2, 6, 0.3
    yield from drive.picture("two_rings")
    settings.capture_radius, settings.capture_lens = 2.2, 50.0
    yield from drive.picture("too_near")
    settings.capture_radius, settings.capture_lens, settings.capture_rings, settings.capture_cameras = 0.0, 40.0, 1, 2
    settings.capture_folder, settings.capture_width, settings.capture_height = str(out / "capture"), 128, 96
    settings.capture_samples, settings.capture_range, settings.capture_frame_end = 4, "CUSTOM", 6
    answer["estimate"] = call("chona.estimate_capture", "INVOKE_DEFAULT")
    yield from until_idle(120.0)
    answer["estimated"] = [module("jobs").board.last.status, module("capturing").last_estimate(scene)]
    answer["report"] = module("jobs").board.last.report
    answer["objects"] = sorted(bpy.data.objects.keys())
    yield from drive.picture("estimated")
    answer["capture"] = call("chona.capture", "INVOKE_DEFAULT")
    yield 8.0
    yield from drive.picture("capturing", redraws=2)
    answer["text"] = module("jobs").running().text if module("jobs").running() else "ended"
    yield from until_idle(180.0)
    answer["captured"] = [module("jobs").board.last.status, module("jobs").board.last.result]
    answer["data"] = settings.data_folder
    yield from drive.picture("captured")


drive.run(story())
