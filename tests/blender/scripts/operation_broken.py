"""An extension that cannot load: the panel with the reason, then the mended one. Argument: the zip."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from operation_scene import say

sys.path[:] = [part for part in sys.path if not (Path(part) / "chona_blender").is_dir()]
name = "bl_ext.user_default.chona"
bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=False)
folder = Path(bpy.utils.user_resource("EXTENSIONS")) / "user_default" / "chona"


def state() -> dict:
    """What is registered, and what the report says."""
    failure = sys.modules.get(f"{name}.failure")
    return {
        "classes": sorted(each for each in dir(bpy.types) if each.startswith("CHONA_")),
        "scene": hasattr(bpy.types.Scene, "chona"),
        "report": failure.report() if failure and failure.is_registered() else "",
        "stand-in": bool(failure and failure.is_registered()),
    }


def cycle(module: str, text: str) -> dict:
    """Break a module, enable, disable; mend it, enable, disable. Loaded modules are forgotten, as Blender does it when
    it installs over what is there.
    """
    for loaded in [each for each in sys.modules if each.startswith(name)]:
        del sys.modules[loaded]
    path = folder / module
    whole = path.read_text()
    path.write_text(text.replace("WHOLE", whole))
    bpy.ops.preferences.addon_enable(module=name)
    broken = state()
    copied = bpy.ops.chona.copy_failure.poll()
    bpy.ops.preferences.addon_disable(module=name)
    off = state()
    path.write_text(whole)
    bpy.ops.preferences.addon_enable(module=name)
    mended = state()
    bpy.ops.preferences.addon_disable(module=name)
    return {"broken": broken, "copied": copied, "off": off, "mended": mended, "mended off": state()}


say(
    {
        "syntax": cycle("panels/model.py", "WHOLE\ndef ("),
        "import": cycle("cost_table.py", "WHOLE\nimport no_such_module\n"),
        "register": cycle("strip_view.py", "WHOLE\n\ndef register():\n    raise ValueError('the reason')\n"),
    }
)
