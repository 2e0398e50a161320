"""Shows a job that went on while Blender was closed, as if it had been started here."""

from __future__ import annotations

import bpy

from .. import frames_there, jobs, pick_up
from .bake import finish_bake
from .poll import allowed
from .train import finish_training, training_ended


class CHONA_OT_pick_up(pick_up.DetachableOperator, bpy.types.Operator):
    """Show a bake or training of this file that goes on without Blender, with its progress and Cancel"""

    bl_idname = "chona.pick_up"
    bl_label = "Pick Up Job"
    bl_options = {"INTERNAL"}

    _place: pick_up.Place | None = None

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return allowed(cls, jobs.busy())

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: look, tell what has ended, and wait for what runs."""
        pick_up.look_now()
        result = {"FINISHED"}
        while pick_up.is_waiting():
            result = super().execute(context)
        return result

    def start(self, _context: bpy.types.Context) -> jobs.Job:
        self._place, job = pick_up.take_next()
        self.escapes = self._place.output is not None
        return job

    def finish(self, context: bpy.types.Context, job: jobs.Job) -> str:
        if self._place.output is None:
            return finish_training(context, job)
        return finish_bake(self, context, job, self._place.scene, self._place.output)

    def _ended(self, context: bpy.types.Context, job: jobs.Job) -> set[str]:
        if self._place.output is None:
            told = training_ended(self, job)
            return super()._ended(context, job) if told is None else told
        frames_there.look_again()
        return super()._ended(context, job)


CLASSES = (CHONA_OT_pick_up,)
