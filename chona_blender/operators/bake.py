"""The bake operator, and the one that cancels whatever runs."""

from __future__ import annotations

import bpy

from .. import actions, jobs
from ..errors import ChonaError


def why_no_bake(scene: bpy.types.Scene) -> str:
    """Why a bake cannot start at present, or nothing."""
    settings = scene.chona
    reasons = (
        (jobs.running() is not None, "Wait until the running job has ended, or cancel it"),
        (not settings.model_path, "Choose a model file first"),
        (
            settings.armature is None and not any(item.use for item in settings.objects),
            "Create a rig, or choose an armature, first",
        ),
        (scene.camera is None, "The scene has no camera: add one and make it active"),
    )
    return next((words for applies, words in reasons if applies), "")


class CHONA_OT_bake(jobs.JobOperator, bpy.types.Operator):
    """Render the posed actor to EXR frames in the worker; Blender stays usable meanwhile"""

    bl_idname = "chona.bake"
    bl_label = "Bake"
    bl_options = {"REGISTER"}

    _bake: actions.Bake | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        words = why_no_bake(context.scene)
        if words:
            cls.poll_message_set(words)
        return not words

    def start(self, context: bpy.types.Context) -> jobs.Job:
        self._scene = context.scene.name
        self._bake = actions.start_bake(context.scene)
        if self._bake.warnings:
            self.report(
                {"WARNING"}, f"{len(self._bake.warnings)} bones are scaled or sheared: {self._bake.warnings[0]}"
            )
        return self._bake.job

    def finish(self, _context: bpy.types.Context, job: jobs.Job) -> str:
        written, skipped = job.result.get("written", 0), job.result.get("skipped", 0)
        words = f"{written} frames written"
        if skipped:
            words += f", {skipped} were up to date"
        words += f" in {self._bake.folder}{actions.error_words(job.result)}"
        scene = bpy.data.scenes.get(self._scene)
        if scene is not None and scene.chona.composite_after:
            try:
                words += f"; composited as {actions.add_composite(scene).group.name}"
            except ChonaError as error:
                raise ChonaError(f"{words}, but not composited: {error}") from error
        return words


class CHONA_OT_cancel(bpy.types.Operator):
    """Stop the running job after its current step; finished frames and checkpoints stay"""

    bl_idname = "chona.cancel"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        if jobs.running() is None:
            cls.poll_message_set("Nothing is running")
            return False
        return True

    def execute(self, _context: bpy.types.Context) -> set[str]:
        job = jobs.running()
        if job is not None:
            job.cancel()
        return {"FINISHED"}


CLASSES = (CHONA_OT_bake, CHONA_OT_cancel)
