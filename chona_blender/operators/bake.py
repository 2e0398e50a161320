"""Operators that bake, show what was baked, and cancel whatever runs."""

from __future__ import annotations

from typing import Any

import bpy

from .. import actions, frames_there, jobs
from ..baked_image import baked_frames, baked_image, follow
from ..errors import ChonaError
from ..output import Output, bake_output, output_now
from ..readiness import why_not_ready
from ..scenes import scene_of
from ..shot_job import replaced_words
from .image_editor import image_editor, show_image


def why_no_bake(scene: bpy.types.Scene) -> str:
    """Why a bake cannot start at present, or nothing."""
    return jobs.busy() or why_not_ready(scene)


class CHONA_OT_bake(jobs.JobOperator, bpy.types.Operator):
    """Render the posed actors to EXR frames in the worker; Blender stays usable meanwhile"""

    bl_idname = "chona.bake"
    bl_label = "Bake"
    bl_options = {"REGISTER"}

    current: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Current Frame",
        description="Bake the frame that the scene stands at, and no others",
        options={"SKIP_SAVE"},
    )
    _bake: actions.Bake | None = None

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        if properties.current:
            return "Bake the frame that the scene stands at, for a quick look; an open image editor shows it"
        return cls.__doc__ or ""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        words = why_no_bake(context.scene)
        if words:
            cls.poll_message_set(words)
        return not words

    def start(self, context: bpy.types.Context) -> jobs.Job:
        scene = context.scene
        self._scene = scene.session_uid
        composited = scene.chona.composite_after and not self.current
        self._bake = actions.start_bake(scene, composite=composited, current=self.current)
        if self._bake.warnings:
            self.report(
                {"WARNING"}, f"{len(self._bake.warnings)} bones are scaled or sheared: {self._bake.warnings[0]}"
            )
        return self._bake.job

    def finish(self, context: bpy.types.Context, job: jobs.Job) -> str:
        frames_there.look_again()
        output = self._bake.output
        words = f"{baked_words(job.result)} in {output.folder}{actions.error_words(job.result)}"
        replaced = replaced_words(job.result)
        if replaced:
            self.report({"WARNING"}, replaced)
            jobs.remember_error(replaced, job.title)
        scene = scene_of(self._scene)
        if scene is None:
            return f"{words}; the scene was deleted meanwhile"
        if self.current:
            if image_editor(context) is not None:
                show_frames(context, output, new_window=False)
        elif scene.chona.composite_after:
            try:
                words += f"; composited as {actions.add_composite(scene, output).group.name}"
            except ChonaError as error:
                raise ChonaError(f"{words}, but not composited: {error}") from error
        return words

    def _ended(self, context: bpy.types.Context, job: jobs.Job) -> set[str]:
        frames_there.look_again()  # a bake that was cancelled has left frames too
        return super()._ended(context, job)


def baked_words(result: dict[str, Any]) -> str:
    """`12 frames written, 38 were up to date`, of the worker's result."""
    written, skipped = int(result.get("written", 0)), int(result.get("skipped", 0))
    words = f"{written} frame{'s' * (written != 1)} written"
    return f"{words}, {skipped} left as they were" if skipped else words


def show_frames(context: bpy.types.Context, output: Output, new_window: bool) -> None:
    """A bake's frames in an image editor, at the scene's frame.

    Raises:
        ChonaError: there are none that could be shown.
    """
    frames = baked_frames(output)
    area = show_image(context, baked_image(frames), new_window)
    if area is not None:
        follow(area.spaces.active.image_user, frames)


class CHONA_OT_show_frames(bpy.types.Operator):
    """Show the baked frames in an image editor, at the scene's frame"""

    bl_idname = "chona.show_frames"
    bl_label = "Show Frame"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if output_now(context.scene) is None:
            cls.poll_message_set("Set the output folder and a name first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            show_frames(context, bake_output(context.scene), new_window=True)
        except ChonaError as error:
            return jobs.fail(self, error)
        return {"FINISHED"}


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


CLASSES = (CHONA_OT_bake, CHONA_OT_show_frames, CHONA_OT_cancel)
