"""Preferences of the add-on: where the worker's Python is, what it computes on, and how one is set up."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

DEVICES = (
    ("auto", "Automatic", "A CUDA graphics card where there is one, else the processor"),
    ("cpu", "Processor", "Always the processor"),
    ("cuda", "CUDA", "Always the graphics card; fails where there is none"),
)

BUILDS = (
    ("cpu", "CPU", "For every computer: torch without a graphics card's libraries"),
    ("cuda", "CUDA", "For NVIDIA cards: torch with CUDA 13.0, several gigabytes"),
)


class CHONA_AP_preferences(bpy.types.AddonPreferences):
    """Shown in Edit ▸ Preferences ▸ Add-ons ▸ CHONA."""

    bl_idname = __package__

    worker_python: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Worker Python",
        description="Python 3.11 or newer with torch, or the folder of its environment; empty for the one that "
        "Set Up Worker makes. Blender's own Python is not touched",
        subtype="FILE_PATH",
    )
    device: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Device",
        description="What the worker computes on",
        items=DEVICES,
        default="auto",
    )

    setup_build: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Install for",
        description="Which build of torch Set Up Worker installs",
        items=BUILDS,
        default="cpu",
    )
    setup_python: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Base Python",
        description="Python 3.11 or newer that Set Up Worker makes the environment of; empty for Blender's own, or "
        "the first good one of the system where Blender's cannot",
        subtype="FILE_PATH",
    )
    setup_wheels: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Wheels",
        description="Folder of wheels that Set Up Worker installs from without the network; empty to download them",
        subtype="DIR_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """The settings, the result of the last check, and the worker's environment."""
        from .panels import draw_setup, draw_worker

        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "worker_python")
        layout.prop(self, "device")
        draw_worker(layout, context)
        layout.separator()
        layout.label(text="Environment of the Worker")
        draw_setup(layout, context, self)


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
