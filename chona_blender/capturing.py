"""Captures from the scene's settings: in this process, or in a Blender of its own that a window need not wait for."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import bpy

from . import standin_mesh
from .actions import settings_of, writable_folder
from .bake_frames import SCENE
from .capture import Cast, capture_sequence
from .capture_estimate import CaptureEstimate, estimate_capture
from .capture_files import finish_capture
from .capture_settings import CaptureResult, CaptureSettings, safe_name
from .errors import ChonaError
from .events import need
from .jobs import Job


def capture_meshes(armature: bpy.types.Object) -> list[bpy.types.Object]:
    """Every mesh that the armature deforms or carries; a stand-in is no character."""
    return [
        item
        for item in bpy.data.objects
        if item.type == "MESH"
        and standin_mesh.KEY not in item
        and (item.parent == armature or any(_deforms(modifier, armature) for modifier in item.modifiers))
    ]


def _deforms(modifier: bpy.types.Modifier, armature: bpy.types.Object) -> bool:
    return modifier.type == "ARMATURE" and modifier.object == armature


def check_capture(scene: bpy.types.Scene) -> CaptureSettings:
    """The capture that the scene's settings ask for; what is missing is an error."""
    settings = settings_of(scene)
    if settings.capture_armature is None:
        raise ChonaError("no character is chosen; choose its armature under Capture")
    frames = settings.capture_frames()
    if not frames:
        raise ChonaError("the frame range of the capture is empty; set a last frame that is not before the first")
    thing = settings.capture_object
    return CaptureSettings(
        folder=writable_folder(settings.capture_folder, "capture folder"),
        person=settings.capture_person or safe_name(settings.capture_armature.name),
        object_name=None if thing is None else safe_name(thing.name),
        frames=frames,
        sequence=settings.capture_sequence or None,
        ring=settings.capture_ring(),
        width=settings.capture_width,
        height=settings.capture_height,
        samples=settings.capture_samples,
    )


def cast_of(scene: bpy.types.Scene) -> Cast:
    """Who and what the scene's settings name."""
    settings = settings_of(scene)
    thing = settings.capture_object
    things = [] if thing is None else [each for each in (thing, *thing.children_recursive) if each.type == "MESH"]
    character = [mesh for mesh in capture_meshes(settings.capture_armature) if mesh not in things]
    return Cast(settings.capture_armature, character, things, thing)


def run_capture(scene: bpy.types.Scene, progress: Callable[[int, int, str], None] | None = None) -> CaptureResult:
    """Render the capture in this process and finish the folder."""
    wanted = check_capture(scene)
    cast = cast_of(scene)
    result = capture_sequence(
        scene, cast.armature, cast.character, cast.things, cast.frame, wanted, progress=progress
    )  # fmt: skip
    finish_capture(wanted.folder)
    return result


def run_estimate(scene: bpy.types.Scene) -> CaptureEstimate:
    """Render a frame from two cameras, and say what the capture will take."""
    return estimate_capture(scene, cast_of(scene), check_capture(scene))


class CaptureJob(Job):
    """A capture of a copy of the open file, in a Blender of its own; the copy goes with it.

    Attributes:
        facts: what the capture was asked with (`capture_facts`).
    """

    def __init__(self, scene: bpy.types.Scene, title: str, *more: str) -> None:
        wanted = check_capture(scene)
        self.facts = capture_facts(scene)
        self._place = tempfile.TemporaryDirectory(prefix="chona_capture_")
        copy = Path(self._place.name) / "scene.blend"
        bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True, check_existing=False)
        command = [bpy.app.binary_path, "--background", "--addons", __package__, str(copy), "--python-exit-code", "1"]
        command += ["--command", "chona", "capture", "--scene", scene.name, "--capture-folder", str(wanted.folder)]
        words = f"{title} {wanted.sequence_name}"
        super().__init__(words, [*command, "--progress", "json", *more], environment=dict(os.environ))
        self.words = "starting a Blender of its own"

    def poll(self) -> bool:
        """As every job's; with its end the copy goes."""
        ended = super().poll()
        if ended:
            self._place.cleanup()
        return ended


def start_capture(scene: bpy.types.Scene) -> CaptureJob:
    """Have a Blender of its own capture a copy of the open file, so that the window stays usable."""
    return CaptureJob(scene, "Capture")


def start_estimate(scene: bpy.types.Scene) -> CaptureJob:
    """The same for an estimate."""
    return CaptureJob(scene, "Estimate", "--estimate")


def capture_facts(scene: bpy.types.Scene) -> tuple[object, ...]:
    """What an estimate depends on, as far as settings say; reading it computes nothing."""
    settings = settings_of(scene)
    own = (settings.capture_frame_start, settings.capture_frame_end, settings.capture_frame_step)
    frames = (scene.frame_start, scene.frame_end, scene.frame_step) if settings.capture_range == SCENE else own
    names = tuple(
        "" if item is None else item.name for item in (settings.capture_armature, settings.capture_object)
    )  # fmt: skip
    size = (settings.capture_width, settings.capture_height, settings.capture_samples)
    place = (settings.capture_folder, settings.capture_person, settings.capture_sequence)
    return (*names, frames, settings.capture_ring(), size, place)


_estimates: dict[int, tuple[tuple[object, ...], str]] = {}


def keep_estimate(scene: bpy.types.Scene, job: CaptureJob) -> str:
    """Remember what an estimate has said; returns its words."""
    need(job.result, "words")
    words = job.result["words"]
    _estimates[scene.session_uid] = job.facts, words
    return words


def last_estimate(scene: bpy.types.Scene) -> tuple[str, bool]:
    """Words of the last estimate (nothing without one), and whether settings have changed since."""
    facts, words = _estimates.get(scene.session_uid, ((), ""))
    return words, bool(words) and facts != capture_facts(scene)


def forget() -> None:
    """Drop estimates: the add-on is switched off."""
    _estimates.clear()
