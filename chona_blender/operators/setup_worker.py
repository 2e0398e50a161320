"""Set up the worker's environment, take it away, and open the preference that both may need."""

from __future__ import annotations

import textwrap

import bpy

from .. import diagnosis, jobs, live_kept, messages, preferences, worker_home, worker_setup
from ..areas import redraw_areas
from ..errors import ChonaError
from ..i18n import report_text
from ..job_operator import JobOperator
from .poll import allowed, needs


class CHONA_OT_set_up_worker(JobOperator, bpy.types.Operator):
    """Make a Python environment with torch for the worker, after showing what is installed and how big it is"""

    bl_idname = "chona.set_up_worker"
    bl_label = "Set Up Worker"
    bl_options = {"REGISTER"}

    build: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Install for", description="Which build of torch is installed", items=preferences.BUILDS,
        options={"SKIP_SAVE"},
    )  # fmt: skip
    python: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Base Python", description="Python 3.11 or newer to make the environment of; empty to find one",
        subtype="FILE_PATH", options={"SKIP_SAVE"},
    )  # fmt: skip
    wheels: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Wheels", description="Folder of wheels to install from without the network; empty to download them",
        subtype="DIR_PATH", options={"SKIP_SAVE"},
    )  # fmt: skip
    torch_index: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="torch Index", description="Package index to take torch from; empty for PyTorch's own",
        options={"SKIP_SAVE"},
    )  # fmt: skip

    _lines: tuple[tuple[str, str], ...] = ()
    """Of the dialog, with their icons; empty where there was none."""

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return allowed(cls, jobs.busy())

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Show what would be done; the dialog's button starts it."""
        found = preferences.preferences()
        if found is not None:
            for name in ("build", "python", "wheels"):
                if not self.properties.is_property_set(name):
                    setattr(self, name, getattr(found, f"setup_{name}"))
        try:
            outlook = worker_setup.outlook(self._choice())
            if outlook.problem:
                raise ChonaError(outlook.problem)
        except ChonaError as error:
            return messages.fail(self, error)
        self._lines = tuple(
            (part, "BLANK1" if number else "DOT")
            for line in outlook.lines
            for number, part in enumerate(textwrap.wrap(line, 80))
        )
        return context.window_manager.invoke_props_dialog(self, width=520, title="Set Up Worker", confirm_text="Set Up")

    def draw(self, _context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        for text, icon in self._lines:
            column.label(text=text, icon=icon)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """After the dialog the window stays usable; from a script it is waited for."""
        if not self._lines:
            return super().execute(context)
        return super().invoke(context, None)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """The preferences show the progress too."""
        redraw_areas("PREFERENCES")
        return super().modal(context, event)

    def start(self, _context: bpy.types.Context) -> jobs.Job:
        live_kept.close_kept()  # it may run in the environment that is replaced
        return worker_setup.start(self._choice())

    def finish(self, _context: bpy.types.Context, job: jobs.Job) -> str:
        diagnosis.worker_report = worker_setup.finish(self._choice(), job)
        found = preferences.preferences()
        if found is not None:
            found.worker_python = ""  # what was named there would go before what was just set up
        return report_text("The worker is set up: {summary}", summary=diagnosis.worker_report.summary)

    def _ended(self, context: bpy.types.Context, job: jobs.Job) -> set[str]:
        if job.status != jobs.CANCELLED:
            return super()._ended(context, job)
        self.report({"WARNING"}, "Set up worker was cancelled; what is downloaded is kept for the next time")
        return {"CANCELLED"}

    def _choice(self) -> worker_setup.Choice:
        return worker_setup.Choice(
            self.build, bpy.path.abspath(self.python), bpy.path.abspath(self.wheels), self.torch_index
        )  # fmt: skip


class CHONA_OT_remove_worker(bpy.types.Operator):
    """Delete the environment that Set Up Worker has made, and what interrupted set-ups have left"""

    bl_idname = "chona.remove_worker"
    bl_label = "Remove Environment"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return allowed(cls, jobs.busy())

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            size = worker_home.occupied()
        except ChonaError as error:
            return messages.fail(self, error)
        if size == 0:
            return self.execute(context)
        message = report_text("Frees {size}", size=worker_setup.size_words(size))
        return context.window_manager.invoke_confirm(
            self, event, title="Remove Environment", message=message, confirm_text="Remove", icon="WARNING"
        )

    def execute(self, _context: bpy.types.Context) -> set[str]:
        live_kept.close_kept()
        try:
            freed = worker_home.remove()
        except ChonaError as error:
            return messages.fail(self, error)
        finally:
            worker_setup.refresh()
        if freed == 0:
            self.report({"INFO"}, "There is no environment to remove")
            return {"FINISHED"}
        diagnosis.worker_report = None
        self.report({"INFO"}, report_text("Removed, {size} are free again", size=worker_setup.size_words(freed)))
        return {"FINISHED"}


class CHONA_OT_open_network_preferences(bpy.types.Operator):
    """Open the preferences at Blender's online access, which is off"""

    bl_idname = "chona.open_network_preferences"
    bl_label = "Open Network Preferences"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, context.window is not None, "Blender runs without a window")

    def execute(self, _context: bpy.types.Context) -> set[str]:
        return bpy.ops.screen.userpref_show(section="SYSTEM")


CLASSES = (CHONA_OT_set_up_worker, CHONA_OT_remove_worker, CHONA_OT_open_network_preferences)
