"""Where a bake goes, which frames it renders and what becomes of those that are there. Arguments: model, worker's
Python, a folder.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import bpy
from mathutils import Matrix
from operation_scene import say

import chona_blender
from chona_blender import commands, frames_there, messages, output
from chona_blender.actions import actor_plans
from chona_blender.bake_frames import checked_frames
from chona_blender.errors import ChonaError
from chona_blender.operators.bake import why_no_bake
from chona_blender.shot import sample_actors

model, python, folder = (Path(part) for part in sys.argv[1:4])
os.environ["CHONA_WORKER_PYTHON"] = str(python)
scene, answer = bpy.context.scene, {}


def words_of(call: object, *arguments: object) -> str:
    """What an error says; nothing where there is none."""
    try:
        call(*arguments)
    except ChonaError as error:
        return str(error)
    return ""


def places() -> None:
    """The folder and name beside the scene's own output, in a saved file and in one that was never saved."""
    settings, found = scene.chona, answer.setdefault("places", [])
    settings.use_scene_output, settings.name, settings.output_folder = True, "shot", "//chona/"
    for path in ("//render/walk_####.png", "//render/", "/renders/sh010_", "/renders/a.####.exr", "/renders/"):
        scene.render.filepath = path
        where = output.bake_output(scene)
        found.append([str(where.folder), where.name, output.goes_to_temporary(scene)])
    settings.use_scene_output = False
    for name in ("", ".hidden", "a/b"):
        settings.name = name
        answer.setdefault("bad names", []).append(
            [words_of(output.bake_output, scene), output.output_now(scene) is None]
        )
    settings.name, settings.output_folder = "shot", " "
    answer["no folder"] = words_of(output.bake_output, scene)


def ranges() -> None:
    """Every way to choose frames."""
    settings = scene.chona
    found = answer["ranges"] = {}
    scene.frame_start, scene.frame_end, scene.frame_step = 3, 9, 2
    scene.frame_set(7)
    settings.frame_start, settings.frame_end, settings.frame_step = -2, 2, 2
    for name in ("SCENE", "CUSTOM", "CURRENT"):
        settings.frame_range = name
        found[name] = settings.frames()
    settings.frame_range = "MARKERS"
    found["no marker"] = words_of(checked_frames, scene)
    markers = [scene.timeline_markers.new(f"m{frame}", frame=frame) for frame in (4, 8, 12)]
    for chosen in ((0,), (0, 1), (2,)):
        for index, marker in enumerate(markers):
            marker.select = index in chosen
        found[f"markers {chosen}"] = settings.frames()
    scene.timeline_markers.clear()
    settings.frame_range, settings.frame_start = "CUSTOM", 3
    found["empty"] = words_of(checked_frames, scene)
    settings.frame_range, scene.frame_step = "SCENE", 1


def furnish() -> None:
    """Two actors of two files before the camera; the second is switched off."""
    for each in list(bpy.data.objects):
        if each.type != "CAMERA":
            bpy.data.objects.remove(each)
    scene.camera.matrix_world = Matrix(((1, 0, 0, 0), (0, 0, -1, -3), (0, 1, 0, 0.2), (0, 0, 0, 1)))
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    scene.chona.model_path = str(model)
    bpy.ops.chona.create_rig()
    other = model.with_name("other.safetensors")
    shutil.copy(model, other)
    bpy.ops.chona.actor_add()
    scene.chona.model_path = str(other)
    bpy.ops.chona.create_rig()
    scene.chona.armature.location.x = 0.6
    scene.chona.actors[1].use = False
    scene.chona.active_actor = 1
    bone = scene.chona.actors[0].armature.pose.bones[1]
    bone.rotation_mode = "XYZ"
    for frame in (1, 2, 3):
        bone.rotation_euler.x = 0.2 * frame
        bone.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_start, scene.frame_end = 1, 3


def obstacles() -> None:
    """Why a bake cannot start, whoever of the actors is the reason; the selected one is not used here."""
    first = scene.chona.actors[0]
    found = answer["obstacles"] = {"nothing yet": why_no_bake(scene)}

    def look(name: str, owner: object, attribute: str, value: object) -> None:
        before = getattr(owner, attribute)
        setattr(owner, attribute, value)
        found[name] = why_no_bake(scene)
        setattr(owner, attribute, before)

    look("no armature", first, "armature", None)
    look("no empty", first.objects[0], "empty", None)
    look("no model", first, "model_path", "")
    look("model gone", first, "model_path", str(folder / "none.safetensors"))
    look("nobody", first, "use", False)
    look("no camera", scene, "camera", None)
    look("panoramic", scene.camera.data, "type", "PANO")
    camera, scene.camera = scene.camera, None
    scene.timeline_markers.new("cut", frame=1).camera = camera
    found["camera by marker"] = why_no_bake(scene)
    scene.timeline_markers.clear()
    scene.camera = camera
    found["nothing again"] = why_no_bake(scene)


def stamps() -> dict[str, int]:
    """When each frame was written."""
    return {path.stem[-4:]: path.stat().st_mtime_ns for path in sorted(frames.glob("*.exr"))}


def bake(**options: object) -> list[str]:
    """Which frames a bake has written anew."""
    before = stamps()
    assert bpy.ops.chona.bake(**options) == {"FINISHED"}, messages.last_error()
    return [number for number, time in stamps().items() if before.get(number) != time]


def existing_frames() -> None:
    """A frame that is gone and one that is out of date, under each choice."""
    settings = scene.chona
    settings.output_folder, settings.name, settings.preset, settings.composite_after = (
        str(frames),
        "walk",
        "draft",
        False,
    )
    found = answer["written"] = {"at first": bake()}
    answer["there"] = sorted(frames_there.numbers_in(frames, "walk"))
    (frames / "walk_0002.exr").unlink()
    bone = settings.actors[0].armature.pose.bones[1]
    bone.rotation_euler.x = 0.9
    bone.keyframe_insert("rotation_euler", frame=3)
    settings.existing = "KEEP"
    found["keep"] = bake()
    settings.existing = "UPDATE"
    found["update"] = bake()
    found["command"] = commands.main(["bake", "--only-missing", "--frames", "1-3"])
    settings.existing = "OVERWRITE"
    settings.frame_range = "SCENE"
    found["overwrite"] = bake()


def current_frame() -> None:
    """One frame of both models' actors inside a border; the shot of the range stays."""
    scene.chona.actors[1].use = True
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 1.0, 0.0, 0.5
    scene.frame_set(2)
    shot = (frames / "walk.shot.npz").stat().st_mtime_ns
    answer["written"]["current"] = bake(current=True)
    answer["shot stays"] = (frames / "walk.shot.npz").stat().st_mtime_ns == shot
    answer["left"] = sorted(path.name for path in frames.iterdir())
    render.use_border = False


def cameras_by_markers() -> None:
    """Each frame has the camera of the last marker before it, with its own keys and shift."""
    second = scene.camera.copy()
    second.data = scene.camera.data.copy()
    second.location.x += 1.0
    second.data.shift_x = 0.25
    scene.collection.objects.link(second)
    for frame, lens in ((1, 50.0), (3, 70.0)):
        second.data.lens = lens
        second.data.keyframe_insert("lens", frame=frame)
    for frame, camera in ((1, scene.camera), (2, second)):
        scene.timeline_markers.new(camera.name, frame=frame).camera = camera
    shot = sample_actors(scene, actor_plans(scene), [1, 2, 3], "walk")
    answer["camera x"] = shot.arrays["camera.world_from_camera"][:, 0, 3].tolist()
    answer["camera lens"] = shot.arrays["camera.intrinsics"][:, 0, 0].tolist()
    answer["camera centre"] = shot.arrays["camera.intrinsics"][:, 0, 2].tolist()


frames = folder / "frames"
chona_blender.register()
places()
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
scene = bpy.context.scene
places()
ranges()
answer["empty scene"] = why_no_bake(scene)
furnish()
obstacles()
existing_frames()
current_frame()
cameras_by_markers()
chona_blender.unregister()
say(answer)
