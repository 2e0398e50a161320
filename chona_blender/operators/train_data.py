"""What the data folder holds, with pictures."""

from __future__ import annotations

import bpy

from .. import jobs, messages, train_data
from ..errors import ChonaError
from ..job_operator import JobOperator
from ..readiness import NO_CAPTURES
from ..train_data import CheckDataJob
from .image_editor import load_anew, show_image
from .poll import allowed, needs


class CHONA_OT_check_data(JobOperator, bpy.types.Operator):
    """Draw skeletons, boxes and masks as they are understood over some images of every sequence, and measure them"""

    bl_idname = "chona.check_data"
    bl_label = "Check Data"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return allowed(cls, jobs.busy() or ("" if context.scene.chona.data_folder else NO_CAPTURES))

    def start(self, context: bpy.types.Context) -> CheckDataJob:
        return train_data.start_check(context.scene)

    def finish(self, _context: bpy.types.Context, job: jobs.Job) -> str:
        if not isinstance(job, CheckDataJob):
            return "Checked"
        found = train_data.keep(job)
        if found.problem:
            raise ChonaError(found.problem)
        if found.warnings:
            return f"{found.headline}: {len(found.warnings)} warnings, the first: {found.warnings[0]}"
        return f"{found.headline}: the data look right"


class CHONA_OT_next_sheet(bpy.types.Operator):
    """Show the picture of another sequence"""

    bl_idname = "chona.next_sheet"
    bl_label = "Another Sequence"
    bl_options = {"INTERNAL"}

    by: bpy.props.IntProperty(name="By", description="-1 shows the one before, 1 the next", default=1)  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, train_data.shown_sheet(context.scene), "Press Check Data first")

    def execute(self, context: bpy.types.Context) -> set[str]:
        shown = train_data.shown_sheet(context.scene)
        if shown is not None:
            try:
                train_data.show_sheet(train_data.key_of(context.scene), shown[0] + self.by)
            except ChonaError as error:
                return messages.fail(self, error)
        return {"FINISHED"}


class CHONA_OT_open_sheet(bpy.types.Operator):
    """Show this picture at its full size in an image editor"""

    bl_idname = "chona.open_sheet"
    bl_label = "Open"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, train_data.shown_sheet(context.scene), "Press Check Data first")

    def execute(self, context: bpy.types.Context) -> set[str]:
        shown = train_data.shown_sheet(context.scene)
        path = shown[1].sheet if shown is not None else None
        try:
            image = load_anew(str(path))
        except RuntimeError:
            return messages.fail(
                self, ChonaError(f"the picture {path} cannot be read any more; press Check Data again")
            )
        show_image(context, image)
        return {"FINISHED"}


CLASSES = (CHONA_OT_check_data, CHONA_OT_next_sheet, CHONA_OT_open_sheet)
