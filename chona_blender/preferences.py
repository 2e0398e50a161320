"""Preferences of the add-on: where the worker's Python is and what it computes on."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

DEVICES = (
    ("auto", "Automatic", "A CUDA graphics card where there is one, else the processor"),
    ("cpu", "Processor", "Always the processor"),
    ("cuda", "CUDA", "Always the graphics card; fails where there is none"),
)


class CHONA_AP_preferences(bpy.types.AddonPreferences):
    """Shown in Edit ▸ Preferences ▸ Add-ons ▸ CHONA."""

    bl_idname = __package__

    worker_python: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Worker Python",
        description="Python 3.11 or newer with torch, or the folder of its environment; empty to look for one. "
        "Blender's own Python is not touched",
        subtype="FILE_PATH",
    )
    device: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Device",
        description="What the worker computes on",
        items=DEVICES,
        default="auto",
    )

    def draw(self, _context: bpy.types.Context) -> None:
        """The settings, and the result of the last check."""
        from .panels import draw_worker

        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "worker_python")
        layout.prop(self, "device")
        draw_worker(layout)


def preferences() -> CHONA_AP_preferences | None:
    """The add-on's preferences; None where it runs as a plain module or with --factory-startup."""
    addon = bpy.context.preferences.addons.get(__package__)
    return None if addon is None else addon.preferences


_override = {"python": "", "device": ""}


@contextmanager
def overridden(python: str = "", device: str = "") -> Iterator[None]:
    """What a command line names goes before the preferences, for as long as the command runs."""
    _override.update(python=python, device=device)
    try:
        yield
    finally:
        _override.update(python="", device="")


def worker_python() -> str:
    """The Python that the user has named, or nothing."""
    if _override["python"]:
        return _override["python"]
    found = preferences()
    return "" if found is None else bpy.path.abspath(found.worker_python)


def device() -> str:
    """The device that the user has chosen."""
    if _override["device"]:
        return _override["device"]
    found = preferences()
    return "auto" if found is None else found.device
