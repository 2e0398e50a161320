"""Runs inside the real Blender with a window: what an animator does while the live preview is on; counts what is left.

`blender --python-use-system-env --python live_window.py -- MODEL PYTHON FOLDER [PART…]`, with the repository and this
folder on $PYTHONPATH; PYTHON is the worker's, and without parts all are told.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Matrix
from window import Drive, call, region_of, until, view_area, window

import chona_blender
from chona_blender import live, live_view

words = sys.argv[sys.argv.index("--") + 1 :]
model, python, out = (Path(part) for part in words[:3])
chosen = words[3:]
os.environ["CHONA_WORKER_PYTHON"] = str(python)
drive = Drive(out)
answer = drive.answer
preview = live.preview
PATIENCE = 300.0
SIZE = (96, 72)


def scene() -> bpy.types.Scene:
    """The scene of the first window."""
    return window().scene


def bone() -> bpy.types.PoseBone:
    """What is posed."""
    return scene().chona.armature.pose.bones[1]


def stage() -> str:
    """What the line in the view begins with."""
    return preview.canvas.line.split(" ")[0]


def settled() -> bool:
    """Whether the pose has its final picture, and nothing is under way."""
    asked = preview._asked
    return preview._changed is None and asked is not None and asked.number == preview._shown and stage() == "final"


def at_rest() -> Iterator[float]:
    """Let Blender see an edit, and wait for the final picture of what is now."""
    window().view_layer.update()
    yield 0.05
    yield from until(lambda: settled() and not preview.canvas.is_empty, PATIENCE)


def in_view(operator: Callable[..., object], *arguments: object, **options: object) -> object:
    """An operator with the mouse over the 3D view."""
    area = view_area()
    with bpy.context.temp_override(window=window(), area=area, region=region_of(area, "WINDOW")):
        return operator(*arguments, **options)


def traces() -> dict[str, int]:
    """What a preview has in Blender and in the system."""
    names = ("depsgraph_update_post", "frame_change_post", "undo_post", "redo_post", "load_pre")
    own = [each for name in names for each in getattr(bpy.app.handlers, name) if each.__module__ == live.__name__]
    return {
        "handlers": len(own), "timers": int(bpy.app.timers.is_registered(live._tick)), "workers": len(workers()),
        "drawing": int(preview.canvas.is_on), "images": len(bpy.data.images),
    }  # fmt: skip


def workers() -> list[int]:
    """Live workers of this process."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, parent = (place / "stat").read_text().rpartition(")")[2].split()[:2]
            if int(parent) == os.getpid() and state != "Z" and b"serve" in (place / "cmdline").read_bytes():
                found.append(int(place.name))
    return found


def memory() -> float:
    """Megabytes that this process holds."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024.0


def furnish() -> None:
    """A rig before the camera, and a view through it."""
    for each in list(bpy.data.objects):
        if each.type != "CAMERA":
            bpy.data.objects.remove(each)
    scene().camera.matrix_world = Matrix(((1, 0, 0, 0), (0, 0, -1, -3), (0, 1, 0, 0.2), (0, 0, 0, 1)))
    scene().render.resolution_x, scene().render.resolution_y = SIZE
    scene().render.engine = "BLENDER_WORKBENCH"
    scene().chona.model_path = str(model)
    call("chona.create_rig", "EXEC_DEFAULT")
    bone().rotation_mode = "XYZ"
    for frame, turn in ((1, -0.4), (25, 0.4), (50, -0.4)):
        bone().rotation_euler.x = turn
        bone().keyframe_insert("rotation_euler", frame=frame)
    scene().frame_start, scene().frame_end = 1, 50
    scene().frame_set(1)
    view_area().spaces.active.region_3d.view_perspective = "CAMERA"


def frame_errors() -> list[float]:
    """How far the drawn frame's corners lie from where Blender projects the camera's, pixels, in every view."""
    found = []
    for region, view in live_view.camera_views(scene()):
        camera = scene().camera
        world = camera.matrix_world.normalized()
        corners = [location_3d_to_region_2d(region, view, world @ c) for c in camera.data.view_frame(scene=scene())]
        low, high = np.min(corners, axis=0), np.max(corners, axis=0)
        frame = live_view.camera_frame(region, view, scene())
        drawn = [frame.left, frame.bottom, frame.left + frame.width, frame.bottom + frame.height]
        found.append(float(np.abs(np.array(drawn) - [*low, *high]).max()))
    return found


def story() -> Iterator[float]:
    """Each part leaves the preview on, with the figure at rest."""
    chona_blender.register()
    yield 0.3
    furnish()
    yield 0.5
    answer["before"] = traces()
    answer["on"] = call("chona.live_preview", "EXEC_DEFAULT")
    yield from at_rest()
    yield from drive.picture("at_rest")
    answer["while on"] = traces()
    for part in PARTS:
        if part.__name__ in chosen or not chosen:
            answer["part"] = part.__name__
            yield from part()
            drive.save()
    yield from ends()


def views() -> Iterator[float]:
    """Quad view, two views, two windows; zoomed and shifted ones."""
    area = view_area()
    in_view(bpy.ops.screen.region_quadview)
    yield 0.5
    answer["quad"] = [len(list(live_view.camera_views(scene()))), frame_errors()]
    yield from drive.picture("quad")
    in_view(bpy.ops.screen.region_quadview)
    view_area().spaces.active.region_3d.view_perspective = "CAMERA"
    yield 0.5
    with bpy.context.temp_override(window=window(), area=area, region=region_of(area, "WINDOW")):
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    yield 0.5
    for each in window().screen.areas:
        if each.type == "VIEW_3D":
            each.spaces.active.region_3d.view_perspective = "CAMERA"
    bpy.ops.wm.window_new()
    yield 1.0
    other = bpy.context.window_manager.windows[-1]
    other.screen.areas[0].type = "VIEW_3D"
    other.screen.areas[0].spaces.active.region_3d.view_perspective = "CAMERA"
    yield 1.0
    answer["views in two windows"] = [len(list(live_view.camera_views(scene()))), frame_errors()]
    with bpy.context.temp_override(window=other):
        bpy.ops.wm.window_close()
    yield 0.5
    yield from drive.picture("two_views")


def cameras() -> Iterator[float]:
    """Zoomed, rolled, shifted, orthographic, with a border, far from the origin; then another one by a marker."""
    view, lens, render = view_area().spaces.active.region_3d, scene().camera.data, scene().render
    upright = scene().camera.matrix_world.copy()
    errors = answer["frames"] = {}
    changes: dict[str, tuple[Callable[[], None], Callable[[], None]]] = {
        "zoomed": (
            lambda: (setattr(view, "view_camera_zoom", 30.0), setattr(view, "view_camera_offset", (0.1, -0.05))),
            lambda: (setattr(view, "view_camera_zoom", 0.0), setattr(view, "view_camera_offset", (0.0, 0.0))),
        ),
        "rolled": (
            lambda: setattr(scene().camera, "matrix_world", upright @ Matrix.Rotation(0.5, 4, "Z")),
            lambda: setattr(scene().camera, "matrix_world", upright),
        ),
        "shifted": (lambda: setattr(lens, "shift_x", 0.2), lambda: setattr(lens, "shift_x", 0.0)),
        "orthographic": (lambda: setattr(lens, "type", "ORTHO"), lambda: setattr(lens, "type", "PERSP")),
        "cropped": (
            lambda: (setattr(render, "use_border", True), setattr(render, "use_crop_to_border", True),
                     setattr(render, "border_max_x", 0.6)),
            lambda: (setattr(render, "use_border", False), setattr(render, "border_max_x", 1.0)),
        ),
    }  # fmt: skip
    for name, (there, back) in changes.items():
        there()
        yield from at_rest()
        yield from drive.picture(name)
        errors[name] = [*frame_errors(), preview.canvas._picture.image.width]
        back()
    second = scene().camera.copy()
    second.location.x += 1.0
    scene().collection.objects.link(second)
    for frame, camera in ((1, scene().camera), (30, second)):
        scene().timeline_markers.new(camera.name, frame=frame).camera = camera
    first = preview._shot.arrays["camera.world_from_camera"]
    scene().frame_set(30)
    yield from at_rest()
    moved = preview._shot.arrays["camera.world_from_camera"] - first
    answer["marker's camera"] = [scene().camera == second, float(moved[0, 0, 3])]
    scene().frame_set(1)
    scene().timeline_markers.clear()
    yield from at_rest()


def playback() -> Iterator[float]:
    """Three seconds of it: how many pictures came, how old the oldest was, and how long the window stood still."""
    in_view(bpy.ops.screen.animation_play)
    seen, gaps, ages, frames = set(), [], [], set()
    end = last = time.monotonic()
    while last < end + 3.0:
        yield 0.005
        now = time.monotonic()
        gaps.append(now - last)
        last = now
        frames.add(scene().frame_current)
        seen.add(preview._shown)
        if preview._changed is not None and not preview.canvas.is_empty:
            ages.append(now - preview._changed - preview._pace.patience)
    in_view(bpy.ops.screen.animation_play)
    answer["playback"] = {"pictures": len(seen), "frames": len(frames), "longest gap": max(gaps), "oldest": max(ages)}
    scene().frame_set(1)
    yield from at_rest()


def stale() -> Iterator[float]:
    """A worker that does not answer: the picture goes while the figure moves, and comes back."""
    pid = preview._worker._process.pid
    os.kill(pid, signal.SIGSTOP)
    bone().rotation_euler.x = 0.1
    yield 0.2
    bone().rotation_euler.x = 0.2
    yield from until(lambda: preview.canvas.is_empty, 20.0)
    answer["hidden"] = preview.canvas.line
    os.kill(pid, signal.SIGCONT)
    yield from at_rest()


def history() -> Iterator[float]:
    """An undone pose; an armature that is deleted, and undone."""
    in_view(bpy.ops.ed.undo_push, message="rest")
    bone().rotation_euler.y = 0.7
    in_view(bpy.ops.ed.undo_push, message="posed")
    yield from at_rest()
    posed = preview.canvas._picture.rgba
    in_view(bpy.ops.ed.undo)
    yield from at_rest()
    answer["undone"] = float(np.abs(posed - preview.canvas._picture.rgba).max())
    in_view(bpy.ops.ed.redo)
    yield from at_rest()
    answer["redone"] = float(np.abs(posed - preview.canvas._picture.rgba).max())
    bpy.data.objects.remove(scene().chona.armature)
    in_view(bpy.ops.ed.undo_push, message="deleted")
    yield from until(lambda: preview.error, 20.0)
    answer["deleted"] = [preview.error, preview.canvas.is_empty]
    in_view(bpy.ops.ed.undo)
    yield from at_rest()
    answer["deletion undone"] = preview.error


def renders() -> Iterator[float]:
    """F12, Ctrl-F12 and a viewport render with the preview on: the same pixels as without."""
    render = scene().render
    render.filepath, scene().frame_end = str(out / "render_"), 3
    pixels = {}
    for state in ("on", "off"):
        answer[f"rendering {state}"] = []
        for animation in (False, True):
            in_view(bpy.ops.render.render, "INVOKE_DEFAULT", animation=animation, write_still=not animation)
            yield 0.3
            yield from until(lambda: not bpy.app.is_job_running("RENDER"), 60.0)
            yield 0.3
        in_view(bpy.ops.render.opengl, write_still=True, view_context=True)
        pixels[state] = _pixels(out / "render_.png"), _pixels(out / "render_0003.png")
        for window_ in list(bpy.context.window_manager.windows)[1:]:  # of the render
            with bpy.context.temp_override(window=window_):
                bpy.ops.wm.window_close()
        yield 0.5
        call("chona.live_preview", "EXEC_DEFAULT")
        yield 0.3
    yield from at_rest()
    answer["renders differ by"] = [
        float(np.abs(on - off).max()) for on, off in zip(pixels["on"], pixels["off"], strict=True)
    ]
    scene().frame_end = 50


def _pixels(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    try:
        return np.array(image.pixels[:])
    finally:
        bpy.data.images.remove(image)
        path.unlink()


def shadings() -> Iterator[float]:
    """The figure has the same colour in every kind of view."""
    shading = view_area().spaces.active.shading
    for kind in ("WIREFRAME", "SOLID", "RENDERED"):
        shading.type = kind
        yield from at_rest()
        yield from drive.picture(f"shading_{kind.lower()}")
    shading.type = "SOLID"


def wrong_states() -> Iterator[float]:
    """Edit mode and a disabled object are told, and end."""
    told = answer["told"] = {}
    armature = scene().chona.armature
    window().view_layer.objects.active = armature
    in_view(bpy.ops.object.mode_set, mode="EDIT")
    yield from until(lambda: preview.error, 20.0)
    told["edit mode"] = [preview.error, preview.canvas.is_empty]
    yield from drive.picture("edit_mode")
    in_view(bpy.ops.object.mode_set, mode="OBJECT")
    yield from at_rest()
    before = preview.canvas._picture.rgba
    item, shown = scene().chona.actor.objects[0], preview._shown
    item.use = False
    yield from until(lambda: preview._shown > shown, PATIENCE)
    yield from at_rest()
    told["object switched off"] = float(np.abs(before - preview.canvas._picture.rgba).max())
    item.use = True
    yield from at_rest()
    told["after"] = preview.error


def worker_ends() -> Iterator[float]:
    """Killed twice: the first time the next pose starts another, then the button does."""
    told = answer["killed"] = []
    for again in (False, True):
        os.kill(preview._worker._process.pid, signal.SIGKILL)
        yield from until(lambda: "signal" in preview.error, 20.0)
        told.append([preview.error, preview.canvas.is_empty])
        bone().rotation_euler.y += 0.1
        if again:
            window().view_layer.update()
            yield 1.0
            answer["waits for the button"] = preview.stopped
            yield from drive.picture("start_again")
            answer["button"] = call("chona.live_restart", "EXEC_DEFAULT")
        yield from at_rest()
    answer["after restart"] = traces()


def models() -> Iterator[float]:
    """The model's file is replaced, goes, and comes back, while nothing else changes."""
    old = preview._worker
    copy = model.with_name("copy.safetensors")
    shutil.copy(model, copy)
    os.utime(copy, ns=(1, 1))
    copy.replace(model)
    yield from until(lambda: preview._worker is not old, 20.0)
    yield from at_rest()
    model.rename(copy)
    yield from until(lambda: preview.error, 20.0)
    answer["model gone"] = [preview.error, preview.canvas.is_empty]
    copy.rename(model)
    yield from at_rest()
    answer["model back"] = [preview.error, traces()]


def scenes() -> Iterator[float]:
    """The window shows another scene, and the first again; then the scene is deleted."""
    first = scene()
    other = bpy.data.scenes.new("Other")
    window().scene = other
    yield 0.5
    answer["other scene"] = [preview.is_on, preview.is_on_for(other), len(list(live_view.camera_views(first)))]
    window().scene = first
    bone().rotation_euler.y += 0.1
    yield from at_rest()
    window().scene = other
    bpy.data.scenes.remove(first)
    yield 0.5
    answer["scene deleted"] = [preview.is_on, traces()]


def leaks() -> Iterator[float]:
    """A new file while it is on; then eighty pictures, whose memory must not stay."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=False)
    yield 1.0
    furnish()
    yield 0.5
    call("chona.live_preview", "EXEC_DEFAULT")
    yield from at_rest()
    held = []
    for turn in range(100):
        shown = preview._shown
        bone().rotation_euler.y = 0.01 * (turn + 1)
        yield from until(lambda shown=shown: preview._shown > shown, PATIENCE, every=0.01)
        if turn == 20:
            held.append(memory())
    held.append(memory())
    answer["memory grew by"] = held[1] - held[0]
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=False)
    yield 1.0
    answer["after a new file"] = [preview.is_on, traces()]


def ends() -> Iterator[float]:
    """Switched off with the add-on while it is on; then on again, and Blender is quit."""
    furnish()
    yield 0.5
    call("chona.live_preview", "EXEC_DEFAULT")
    yield 1.0
    chona_blender.unregister()
    answer["unregistered"] = traces()
    chona_blender.register()
    furnish()
    yield 0.5
    call("chona.live_preview", "EXEC_DEFAULT")
    yield from at_rest()
    answer["worker"] = preview._worker._process.pid
    drive.save()
    bpy.ops.wm.quit_blender()


PARTS = (views, cameras, playback, stale, history, renders, shadings, wrong_states, worker_ends, models, scenes, leaks)
drive.run(story())
