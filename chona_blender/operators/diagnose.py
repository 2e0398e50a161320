"""Check the worker, open the output folder, copy the report."""

from __future__ import annotations

import bpy

from .. import diagnosis, jobs, messages, preferences
from ..areas import redraw_areas
from ..errors import ChonaError
from ..job_operator import JobOperator
from ..output import bake_output, output_now
from ..worker import find_python
from ..worker_check import check_worker, judge, probe_command
from .poll import allowed, needs


class CHONA_OT_check_worker(JobOperator, bpy.types.Operator):
    """Start the worker's Python, load everything it needs and say in words what is wrong"""

    bl_idname = "chona.check_worker"
    bl_label = "Check Worker"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return allowed(cls, jobs.busy())

    def execute(self, _context: bpy.types.Context) -> set[str]:
        diagnosis.worker_report = check_worker(preferences.worker_python(), device=preferences.device())
        if not diagnosis.worker_report.good:
            return messages.fail(self, ChonaError(diagnosis.worker_report.summary))
        self.report({"INFO"}, f"The worker is ready: {diagnosis.worker_report.summary}")
        return {"FINISHED"}

    def start(self, _context: bpy.types.Context) -> jobs.Job:
        self._python = find_python(preferences.worker_python())
        return jobs.Job("Check worker", probe_command(self._python[0], load=True))

    def _ended(self, context: bpy.types.Context, job: jobs.Job) -> set[str]:
        if job.status != jobs.CANCELLED:
            job.status = jobs.DONE  # a probe that crashed is a finding as well
        return super()._ended(context, job)

    def finish(self, _context: bpy.types.Context, job: jobs.Job) -> str:
        diagnosis.worker_report = judge(
            *self._python, job.result or None, job.code, list(job.worker.lines), preferences.device()
        )
        if not diagnosis.worker_report.good:
            raise ChonaError(diagnosis.worker_report.summary)
        return f"The worker is ready: {diagnosis.worker_report.summary}"


class CHONA_OT_open_output(bpy.types.Operator):
    """Open the output folder in the system's file browser"""

    bl_idname = "chona.open_output"
    bl_label = "Open Output Folder"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, output_now(context.scene), "Set the output folder and a name first")

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = bake_output(context.scene).folder
        if not folder.is_dir():
            return messages.fail(self, ChonaError(f"there is no folder {folder} yet; a bake makes it"))
        bpy.ops.wm.path_open(filepath=str(folder))
        self.report({"INFO"}, str(folder))
        return {"FINISHED"}


class CHONA_OT_copy_report(bpy.types.Operator):
    """Copy everything known about the last error, the worker and this Blender to the clipboard"""

    bl_idname = "chona.copy_report"
    bl_label = "Copy Report"
    bl_options = {"INTERNAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.clipboard = diagnosis.report_text()
        self.report({"INFO"}, "The report is on the clipboard")
        return {"FINISHED"}


class CHONA_OT_dismiss_error(bpy.types.Operator):
    """Take the last error off the panel"""

    bl_idname = "chona.dismiss_error"
    bl_label = "Dismiss"
    bl_options = {"INTERNAL"}

    def execute(self, _context: bpy.types.Context) -> set[str]:
        messages.remember_error("")
        redraw_areas("VIEW_3D")
        return {"FINISHED"}


class CHONA_OT_dismiss_news(bpy.types.Operator):
    """Take what happened while Blender was closed off the panel"""

    bl_idname = "chona.dismiss_news"
    bl_label = "Dismiss"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        if not messages.news():
            cls.poll_message_set("Nothing has happened")
            return False
        return True

    def execute(self, _context: bpy.types.Context) -> set[str]:
        messages.news().clear()
        redraw_areas("VIEW_3D")
        return {"FINISHED"}


CLASSES = (
    CHONA_OT_check_worker,
    CHONA_OT_open_output,
    CHONA_OT_copy_report,
    CHONA_OT_dismiss_error,
    CHONA_OT_dismiss_news,
)
