"""Captures from the scene's settings: in this process, or in a Blender of its own that a window need not wait for."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import bpy

from .actions import settings_of, writable_folder
from .capture import CaptureResult, CaptureSettings, capture_sequence
from .capture_files import finish_capture
from .errors import ChonaError
from .jobs import Job


def capture_meshes(armature: bpy.types.Object) -> list[bpy.types.Object]:
    """Every mesh that the armature deforms or carries."""
    return [
        item
        for item in bpy.data.objects
        if item.type == "MESH"
        and (item.parent == armature or any(_deforms(modifier, armature) for modifier in item.modifiers))
    ]


def _deforms(modifier: bpy.types.Modifier, armature: bpy.types.Object) -> bool:
    return modifier.type == "ARMATURE" and modifier.object == armature


def check_capture(scene: bpy.types.Scene) -> CaptureSettings:
    """The capture that the scene's settings ask for; what is missing is an error."""
    settings = settings_of(scene)
    if settings.capture_armature is None:
        raise ChonaError("no character is chosen; choose its armature under Capture")
    frames = settings.frames()
    if not frames:
        raise ChonaError("the frame range is empty; set a last frame that is not before the first")
    thing = settings.capture_object
    return CaptureSettings(
        folder=writable_folder(settings.capture_folder, "capture folder"),
        person=settings.capture_person or settings.capture_armature.name,
        object_name=None if thing is None else thing.name,
        frames=frames,
        sequence=settings.capture_sequence or None,
        ring=settings.capture_cameras,
        width=settings.capture_width,
        height=settings.capture_height,
        samples=settings.capture_samples,
    )


def run_capture(scene: bpy.types.Scene, progress: Callable[[int, int, str], None] | None = None) -> CaptureResult:
    """Render the capture in this process and finish the folder."""
    wanted = check_capture(scene)
    settings = settings_of(scene)
    thing = settings.capture_object
    things = [] if thing is None else [each for each in (thing, *thing.children_recursive) if each.type == "MESH"]
    character = [mesh for mesh in capture_meshes(settings.capture_armature) if mesh not in things]
    result = capture_sequence(scene, settings.capture_armature, character, things, thing, wanted, progress=progress)
    finish_capture(wanted.folder)
    return result


def start_capture(scene: bpy.types.Scene) -> Job:
    """Have a Blender of its own capture a copy of the open file, so that the window stays usable."""
    wanted = check_capture(scene)
    copy = Path(tempfile.mkdtemp(prefix="chona_capture_")) / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True, check_existing=False)
    command = [bpy.app.binary_path, "--background", "--addons", __package__, str(copy), "--python-exit-code", "1"]
    command += ["--command", "chona", "capture", "--scene", scene.name, "--capture-folder", str(wanted.folder)]
    return Job(f"Capture {wanted.sequence_name}", [*command, "--progress", "json"], environment=dict(os.environ))
