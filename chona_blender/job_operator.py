"""Operators over a job: blocking without a window, modal with one."""

from __future__ import annotations

import bpy

from . import jobs, messages
from .areas import redraw_areas
from .errors import ChonaError
from .jobs import Job, board


class JobOperator:
    """Mixin for operators over a job: subclasses give `start` and `finish`.

    With a window, ESC cancels (unless `escapes` is off) and the window stays usable meanwhile.
    """

    escapes = True

    _job: Job | None = None

    def start(self, context: bpy.types.Context) -> Job:
        """Gather what is needed and start the worker; a ChonaError is reported."""
        raise NotImplementedError

    def finish(self, context: bpy.types.Context, job: Job) -> str:
        """Use the result; what comes back is reported."""
        raise NotImplementedError

    def _begun(self, context: bpy.types.Context) -> Job:
        job = self.start(context)
        messages.forget_error(job.title)
        return job

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: wait for the worker."""
        try:
            return self._ended(context, jobs.run_blocking(self._begun(context)))
        except ChonaError as error:
            return messages.fail(self, error)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """With a window: start the worker and let the window go on."""
        if context.window is None:
            return self.execute(context)
        try:
            self._job = board.current = board.last = self._begun(context)
        except ChonaError as error:
            return messages.fail(self, error)
        board.timer = context.window_manager.event_timer_add(jobs.POLL_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Show progress on each timer tick; ESC cancels, everything else goes on to Blender."""
        if self._job is None:
            return {"CANCELLED"}
        playing = context.screen is not None and context.screen.is_animation_playing
        pressed = event.type == "ESC" and event.value == "PRESS" and not playing  # ESC ends the playback first
        if pressed and self.escapes:
            self._job.cancel()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        job = self._job
        ended = job.poll()
        redraw_areas("VIEW_3D")
        if not ended:
            if context.workspace is not None:
                words = f"{job.title}: {job.text}" + "   |   ESC: cancel" * self.escapes
                context.workspace.status_text_set(words)
                board.told.add(context.workspace.session_uid)
            return {"PASS_THROUGH"}
        jobs.let_go()
        try:
            return self._ended(context, job)
        except ChonaError as error:
            return messages.fail(self, error)

    def cancel(self, _context: bpy.types.Context) -> None:
        """Blender ends the operator: another file is loaded, or its window is closed. The panel tells."""
        job, self._job = self._job, None
        if job is None or job is not board.current:
            return
        job.close()
        jobs.let_go()
        if job.error:
            words = f"another file was opened, or the window was closed: {job.error}"
            messages.remember_error(messages.sentence(ChonaError(words)), job.title)

    def _ended(self, context: bpy.types.Context, job: Job) -> set[str]:
        if job.status == jobs.DONE:
            self.report({"INFO"}, self.finish(context, job))
            return {"FINISHED"}
        if job.status == jobs.CANCELLED:
            self.report({"WARNING"}, job.error)
            return {"CANCELLED"}
        return messages.fail(self, ChonaError(job.error), job.title)
