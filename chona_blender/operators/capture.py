"""Training data from the scene: its cameras shown, what it will take, and the capture itself."""

from __future__ import annotations

import bpy

from .. import capturing, jobs, messages, ring_view
from ..capture_command import estimate_words
from ..capturing import CaptureJob
from ..errors import ChonaError
from ..events import need
from ..job_operator import JobOperator
from ..scenes import scene_of
from .poll import allowed, needs

SHOWN_WARNINGS = 20
"""Of a capture in a Blender of its own; nobody reads more."""


def why_no_capture(scene: bpy.types.Scene) -> str:
    """Why a capture cannot start at present, or nothing."""
    return jobs.busy() or ("" if scene.chona.capture_armature else "Choose the armature of the character first")


class CHONA_OT_capture(JobOperator, bpy.types.Operator):
    """Render the character and the object from all cameras as training data, in a Blender of its own"""

    bl_idname = "chona.capture"
    bl_label = "Capture"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return allowed(cls, why_no_capture(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: in this process."""
        try:
            result = capturing.run_capture(context.scene)
        except ChonaError as error:
            return messages.fail(self, error)
        for words in result.warnings:
            self.report({"WARNING"}, words)
        self.report({"INFO"}, f"Captured {result.rendered} frames, {result.skipped} were there: {result.folder}")
        return {"FINISHED"}

    def start(self, context: bpy.types.Context) -> CaptureJob:
        self._scene = context.scene.session_uid
        return capturing.start_capture(context.scene)

    def finish(self, _context: bpy.types.Context, job: jobs.Job) -> str:
        need(job.result, "written", "skipped")
        for words in job.result.get("warnings", ())[:SHOWN_WARNINGS]:
            self.report({"WARNING"}, words)
        scene = scene_of(self._scene)
        if scene is not None and not scene.chona.data_folder:
            scene.chona.data_format = "blender"
            scene.chona.data_folder = scene.chona.capture_folder
        return f"Captured {job.result['written']} frames, {job.result['skipped']} were there"


class CHONA_OT_estimate_capture(JobOperator, bpy.types.Operator):
    """Render two images of the capture, and say how long all of them will take and how large they will be"""

    bl_idname = "chona.estimate_capture"
    bl_label = "Estimate"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return allowed(cls, why_no_capture(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: in this process."""
        try:
            found = capturing.run_estimate(context.scene)
        except ChonaError as error:
            return messages.fail(self, error)
        self.report({"INFO"}, estimate_words(found))
        return {"FINISHED"}

    def start(self, context: bpy.types.Context) -> CaptureJob:
        self._scene = context.scene.session_uid
        return capturing.start_estimate(context.scene)

    def finish(self, _context: bpy.types.Context, job: jobs.Job) -> str:
        scene = scene_of(self._scene)
        if scene is None or not isinstance(job, CaptureJob):
            return "Estimated"
        return capturing.keep_estimate(scene, job)


class CHONA_OT_show_ring(bpy.types.Operator):
    """Draw the capture's cameras into the 3D views, where they follow the settings; the scene stays as it is"""

    bl_idname = "chona.show_ring"
    bl_label = "Show Cameras"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        there = context.scene.chona.capture_armature is not None or ring_view.is_on()
        return needs(cls, there, "Choose the armature of the character first")

    def execute(self, context: bpy.types.Context) -> set[str]:
        ring_view.switch(context.scene, not ring_view.is_on())
        if ring_view.problem(context.scene):
            return messages.fail(self, ChonaError(ring_view.words(context.scene)))
        return {"FINISHED"}


CLASSES = (CHONA_OT_capture, CHONA_OT_estimate_capture, CHONA_OT_show_ring)
