"""Training data from the scene."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy

from .. import capturing, jobs
from ..errors import ChonaError


class CHONA_OT_capture(jobs.JobOperator, bpy.types.Operator):
    """Render the character and the object from a ring of cameras as training data, in a Blender of its own"""

    bl_idname = "chona.capture"
    bl_label = "Capture"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if jobs.running() is not None:
            cls.poll_message_set("Wait until the running job has ended, or cancel it")
            return False
        if context.scene.chona.capture_armature is None:
            cls.poll_message_set("Choose the armature of the character first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            result = capturing.run_capture(context.scene)
        except ChonaError as error:
            return jobs.fail(self, error)
        self.report({"INFO"}, f"Captured {result.rendered} frames, {result.skipped} were there: {result.folder}")
        return {"FINISHED"}

    def start(self, context: bpy.types.Context) -> jobs.Job:
        self._scene = context.scene.name
        return capturing.start_capture(context.scene)

    def _ended(self, context: bpy.types.Context, job: jobs.Job) -> set[str]:
        copy = next(Path(part) for part in job.worker.command if part.endswith("scene.blend"))
        shutil.rmtree(copy.parent, ignore_errors=True)
        return super()._ended(context, job)

    def finish(self, _context: bpy.types.Context, job: jobs.Job) -> str:
        scene = bpy.data.scenes.get(self._scene)
        if scene is not None and not scene.chona.data_folder:
            scene.chona.data_folder = scene.chona.capture_folder
            scene.chona.data_format = "blender"
        return f"Captured {job.result.get('written', 0)} frames, {job.result.get('skipped', 0)} were there"


CLASSES = (CHONA_OT_capture,)
