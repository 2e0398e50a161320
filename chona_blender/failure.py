"""What is shown when the add-on cannot load: the reason, and a button that copies it. Depends on nothing else of the
add-on.
"""

from __future__ import annotations

import atexit
import platform
import sys

import bpy

_text: list[str] = []


class CHONA_OT_copy_failure(bpy.types.Operator):
    """Copy why CHONA could not be loaded to the clipboard"""

    bl_idname = "chona.copy_failure"
    bl_label = "Copy Report"
    bl_options = {"INTERNAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.clipboard = report()
        self.report({"INFO"}, "The report is on the clipboard")
        return {"FINISHED"}


class CHONA_PT_failure(bpy.types.Panel):
    """Says why the add-on is not there."""

    bl_idname = "CHONA_PT_failure"
    bl_label = "CHONA Could Not Be Loaded"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "CHONA"

    def draw(self, _context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        column.label(text="Install the extension again.", icon="ERROR")
        column.label(text="If that does not help, send this report:", icon="BLANK1")
        box = column.box().column(align=True)
        for line in "".join(_text).strip().splitlines()[-6:]:
            box.label(text=line.strip())
        column.operator("chona.copy_failure", icon="COPYDOWN")


CLASSES = (CHONA_OT_copy_failure, CHONA_PT_failure)


def report() -> str:
    """The reason with the versions it happened in."""
    return "\n".join(
        [
            f"Blender {bpy.app.version_string}, Python {sys.version.split()[0]}, {platform.platform()}",
            f"add-on: {__package__}",
            *_text,
        ]
    )


def is_registered() -> bool:
    """Whether the stand-in is there instead of the add-on."""
    return bool(_text)


def register(reason: str) -> None:
    """Show the reason in the sidebar, and on stderr for renders without a window."""
    sys.stderr.write(f"CHONA could not be loaded:\n{reason}\n")
    _text[:] = [reason]
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    if getattr(bpy.app, "module", False):  # the bpy module of 4.5 hangs at exit on classes that are left
        atexit.register(unregister)


def unregister() -> None:
    """Take the stand-in away."""
    _text.clear()
    atexit.unregister(unregister)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
