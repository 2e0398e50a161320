"""What the tests of steadiness share: a small scene, bakes that go on while other things happen, and what is left."""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import signal
import sys
import threading
import time
import types
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy
from bpy.utils import previews
from mathutils import Matrix

from chona_blender import jobs, messages, registration
from chona_blender.operators import bake

PATIENCE = 240.0
FRAMES = 24
SIZE = (48, 36)
DRAWN = {"POST_PIXEL", "POST_VIEW", "PRE_VIEW", "BACKDROP"}


@dataclass(frozen=True)
class Tick:
    """What a modal operator reads of Blender's event when a timer wakes it."""

    type: str = "TIMER"
    value: str = "NOTHING"


class STEADY_OT_bake(bake.CHONA_OT_bake):
    """A bake as with a window: Blender without one only executes operators, and this one begins when executed"""

    bl_idname = "chona.steady_bake"
    bl_label = "Bake"

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self.invoke(context, None)


def register() -> None:
    """The operator above; the bpy module of 4.5 hangs at exit on classes that are left."""
    bpy.utils.register_class(STEADY_OT_bake)
    atexit.register(unregister)


def unregister() -> None:
    """Take it back."""
    atexit.unregister(unregister)
    bpy.utils.unregister_class(STEADY_OT_bake)


def furnish(model: Path, out: Path) -> bpy.types.Scene:
    """A posed rig that moves before the camera, looked at through it; in the scene that is open."""
    scene = bpy.context.scene
    for each in list(bpy.data.objects):
        if each.type != "CAMERA":
            bpy.data.objects.remove(each)
    scene.camera.matrix_world = Matrix(((1, 0, 0, 0), (0, 0, -1, -3), (0, 1, 0, 0.2), (0, 0, 0, 1)))
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.frame_start, scene.frame_end = 1, FRAMES
    settings = scene.chona
    settings.model_path, settings.output_folder, settings.name = str(model), str(out), "walk"
    settings.preset, settings.composite_after = "draft", False
    bpy.ops.chona.create_rig()
    settings.armature.keyframe_insert("location", frame=1)
    settings.armature.location.x = 0.3
    settings.armature.keyframe_insert("location", frame=FRAMES)
    look_through_camera()
    bpy.context.view_layer.update()
    return scene


def look_through_camera() -> None:
    """As Numpad 0 does in every 3D view."""
    for area in bpy.context.window_manager.windows[0].screen.areas:
        if area.type == "VIEW_3D":
            area.spaces.active.region_3d.view_perspective = "CAMERA"


def begin_bake(frames: int = 2) -> jobs.Job:
    """A bake that has so many frames, and stands still until ``go_on``."""
    assert bpy.ops.chona.steady_bake() == {"RUNNING_MODAL"}
    job = jobs.board.current
    tick_until(lambda: job.done >= frames or job.status != jobs.RUNNING, every=0.005)
    assert job.status == jobs.RUNNING, job.report
    os.kill(job.worker._process.pid, signal.SIGSTOP)
    return job


def go_on(job: jobs.Job) -> None:
    """The worker of a bake that stands still goes on."""
    os.kill(job.worker._process.pid, signal.SIGCONT)


def tick_until(condition: Callable[[], object], seconds: float = PATIENCE, every: float = 0.01) -> set[str]:
    """Wake the running operator as its timer does, until something holds; what it returned last."""
    end, result = time.monotonic() + seconds, {"PASS_THROUGH"}
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {seconds:g} s")
        operator = bpy.context.window_manager.windows[0].modal_operators[0]
        result = operator.modal(bpy.context, Tick())
        time.sleep(every)
    return result


def finish() -> list[str]:
    """Wake the running operator until its job has ended."""
    return sorted(tick_until(lambda: jobs.running() is None))


def names_in(folder: Path) -> list[str]:
    """Everything in a folder, hidden files too."""
    return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


def children() -> list[str]:
    """Processes of this one that live or were not waited for."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, parent = (place / "stat").read_text().rpartition(")")[2].split()[:2]
            if int(parent) == os.getpid():
                found.append(f"{state} {(place / 'cmdline').read_bytes().decode().replace(chr(0), ' ')}")
    return found


def is_ours(function: object) -> bool:
    """Whether a function or a method is of the add-on."""
    return str(getattr(function, "__module__", "")).startswith("chona_blender")


def timers() -> list[str]:
    """Our functions that wait for a timer. Blender lists none, so all that live are asked for."""
    kinds = (types.FunctionType, types.MethodType)
    functions = [each for each in gc.get_objects() if isinstance(each, kinds) and is_ours(each)]
    found = [each.__qualname__ for each in functions if bpy.app.timers.is_registered(each)]
    return found + ["modal"] * (jobs.board.timer is not None)


def drawing() -> list[str]:
    """Our functions that Blender calls when it draws: it keeps the arguments of `draw_handler_add` for each."""
    kept = [each for each in gc.get_objects() if type(each) is tuple and len(each) == 5]
    return [each[1].__qualname__ for each in kept if is_ours(each[1]) and isinstance(each[4], str) and each[4] in DRAWN]


def handlers() -> list[str]:
    """Our functions in lists of handlers."""
    lists = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]
    return [each.__qualname__ for found in lists if isinstance(found, list) for each in found if is_ours(each)]


def classes() -> list[str]:
    """Classes of ours that Blender knows."""
    found = {name for name in dir(bpy.types) if name.startswith("CHONA_")}
    return sorted(found | {each.__name__ for each in registration.CLASSES if each.is_registered})


def threads() -> list[str]:
    """Threads besides this one; those that only have to return may do so."""
    for each in threading.enumerate():
        if each is not threading.current_thread():
            each.join(timeout=1.0)
    return [each.name for each in threading.enumerate() if each is not threading.current_thread()]


def left() -> dict[str, object]:
    """Everything that an add-on could leave behind."""
    return {
        "classes": classes(), "handlers": handlers(), "timers": timers(), "drawing": drawing(), "threads": threads(),
        "children": children(), "previews": len(previews._uuid_open), "property": hasattr(bpy.types.Scene, "chona"),
        "images": sorted(each.name for each in bpy.data.images), "groups": len(bpy.data.node_groups),
        "pending": [jobs.board.current is not None, messages.last_error()],
    }  # fmt: skip


def memory() -> float:
    """Megabytes that this process holds."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024.0


def open_files() -> int:
    """File handles of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def worker_python() -> None:
    """The worker's Python is the script's second argument."""
    os.environ["CHONA_WORKER_PYTHON"] = sys.argv[2]
