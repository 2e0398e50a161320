"""Demo stage 1, in Blender: Robin and the crate in two performances, captured from four cameras."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy

from chona_blender.capture import capture_sequence
from chona_blender.capture_files import finish_capture
from chona_blender.capture_settings import CaptureSettings
from demo.animate import key_performance
from demo.body import BONES, PARENTS, PERSON
from demo.character import build_character
from demo.crate import OBJECT, build_crate
from demo.poses import TRAINED, performance
from demo.room import Place, add_camera, add_lights, set_render

CAMERAS: dict[str, Place] = {
    "front_left": (1.5, -2.3, 1.45),
    "front_right": (-1.9, -2.0, 1.2),
    "back_left": (2.1, 1.8, 1.6),
    "back_right": (-1.6, 2.2, 1.3),
}
"""Where the cameras stand, metres; all look at the figure's middle."""

AIM: Place = (0.0, -0.12, 0.84)
LENS = 33.0


def main() -> None:
    """Reads the command line and captures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--width", type=int, required=True)
    parser.add_argument("--height", type=int, required=True)
    parser.add_argument("--samples", type=int, required=True)
    parser.add_argument("--frames", type=int, required=True, help="of each performance")
    arguments = parser.parse_args()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    armature, body = build_character(scene.collection)
    carrier, crate = build_crate(scene.collection)
    add_lights(scene)
    set_render(scene, arguments.width, arguments.height, arguments.samples)
    cameras = [add_camera(scene, name, place, AIM, LENS) for name, place in CAMERAS.items()]
    scene.camera = cameras[0]
    sequences = []
    for name in TRAINED:
        frames = range(1, arguments.frames + 1)
        for item in (armature, carrier):
            item.animation_data_clear()
        key_performance(armature, carrier, performance(name), frames)
        settings = CaptureSettings(
            arguments.folder, PERSON, OBJECT, frames, f"{PERSON}_{OBJECT}_{name}", cameras, width=arguments.width,
            height=arguments.height, samples=arguments.samples, mask_samples=4, names=BONES, parents=PARENTS,
        )  # fmt: skip
        capture_sequence(scene, armature, [body], [crate], carrier, settings)
        sequences.append(settings.sequence_name)
    finish_capture(arguments.folder, sequences)


if __name__ == "__main__":
    main()
    sys.stdout.flush()
