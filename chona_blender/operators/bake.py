"""Operators that bake, show what was baked, and cancel whatever runs."""

from __future__ import annotations

import bpy

from .. import actions, frames_there, jobs, messages, pick_up
from ..baked_image import baked_frames, baked_image, follow
from ..errors import ChonaError
from ..output import Output, bake_output, output_now
from ..readiness import why_not_ready
from ..scenes import scene_of
from ..shot_job import replaced_words
from .image_editor import image_editor, show_image
from .poll import allowed, needs


def why_no_bake(scene: bpy.types.Scene) -> str:
    """Why a bake cannot start at present, or nothing."""
    return jobs.busy() or why_not_ready(scene)


class CHONA_OT_bake(pick_up.DetachableOperator, bpy.types.Operator):
    """Render the posed actors to EXR frames in the worker; Blender stays usable meanwhile"""

    bl_idname = "chona.bake"
    bl_label = "Bake"
    bl_options = {"REGISTER"}

    current: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Current Frame",
        description="Bake the frame that the scene stands at, and no others",
        options={"SKIP_SAVE"},
    )
    _output: Output | None = None

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        if properties.current:
            return "Bake the frame that the scene stands at, for a quick look; an open image editor shows it"
        return cls.__doc__ or ""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return allowed(cls, why_no_bake(context.scene))

    def start(self, context: bpy.types.Context) -> jobs.Job:
        scene = context.scene
        self._scene = scene.session_uid
        place = None if self.current else pick_up.bake_place(scene)
        running = pick_up.running_at(place)
        if running is not None:
            self._output = place.output
            self.report({"INFO"}, f"{running.title} goes on already: this is how far it is")
            return running
        composited = scene.chona.composite_after and not self.current
        detach = scene.chona.detach and not self.current
        bake = actions.start_bake(scene, composite=composited, current=self.current, detach=detach)
        self._output = bake.output
        if bake.warnings:
            self.report({"WARNING"}, f"{len(bake.warnings)} bones are scaled or sheared: {bake.warnings[0]}")
        return bake.job

    def finish(self, context: bpy.types.Context, job: jobs.Job) -> str:
        return finish_bake(self, context, job, self._scene, self._output, self.current)

    def _ended(self, context: bpy.types.Context, job: jobs.Job) -> set[str]:
        frames_there.look_again()  # a bake that was cancelled has left frames too
        return super()._ended(context, job)


def finish_bake(
    operator: bpy.types.Operator, context: bpy.types.Context, job: jobs.Job, scene_uid: int, output: Output,
    current: bool = False,
) -> str:  # fmt: skip
    """Show or composite what was baked, and warn of a model that was replaced meanwhile; words for a report.

    Raises:
        ChonaError: the result says nothing of frames, or they cannot be composited.
    """
    words = f"{pick_up.baked_words(job.result)} in {output.folder}{actions.error_words(job.result)}"
    replaced = replaced_words(job.result)
    if replaced:
        operator.report({"WARNING"}, replaced)
        messages.remember_error(replaced, job.title)
    scene = scene_of(scene_uid)
    if scene is None:
        return f"{words}; the scene was deleted meanwhile"
    if current:
        if image_editor(context) is not None:
            show_frames(context, output, new_window=False)
    elif scene.chona.composite_after:
        try:
            words += f"; composited as {actions.add_composite(scene, output).group.name}"
        except ChonaError as error:
            raise ChonaError(f"{words}, but not composited: {error}") from error
    return words


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
        return needs(cls, output_now(context.scene), "Set the output folder and a name first")

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            show_frames(context, bake_output(context.scene), new_window=True)
        except ChonaError as error:
            return messages.fail(self, error)
        return {"FINISHED"}


class CHONA_OT_cancel(bpy.types.Operator):
    """Stop the running job after its current step; finished frames and checkpoints stay"""

    bl_idname = "chona.cancel"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return needs(cls, jobs.running(), "Nothing is running")

    def execute(self, _context: bpy.types.Context) -> set[str]:
        job = jobs.running()
        if job is not None:
            job.cancel()
        return {"FINISHED"}


CLASSES = (CHONA_OT_bake, CHONA_OT_show_frames, CHONA_OT_cancel)
