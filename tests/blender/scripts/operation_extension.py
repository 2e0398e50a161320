"""Installs the zip as an extension, uses it, and removes it. Arguments: the zip, `install` or `again`."""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path

import bpy
from operation_scene import say

# Only the installed extension may be found, not the sources beside this test.
sys.path[:] = [part for part in sys.path if not (Path(part) / "chona_blender").is_dir()]
package, mode = Path(sys.argv[1]), sys.argv[2]
name = "bl_ext.user_default.chona"
if mode == "install":
    bpy.ops.extensions.package_install_files(filepath=str(package), repo="user_default", enable_on_install=True)
else:
    bpy.ops.preferences.addon_enable(module=name)
module = sys.modules[name]
commands = sys.modules[f"{name}.commands"]
answer = {
    "enabled": name in bpy.context.preferences.addons,
    "preferences": bpy.context.preferences.addons[name].preferences.bl_rna.identifier,
    "folder": str(Path(module.__file__).parent),
    "sources": str(sys.modules[f"{name}.worker"].sources_folder()),
}
words = io.StringIO()
with contextlib.redirect_stdout(words), contextlib.redirect_stderr(words):
    answer["code"] = commands.main(["check", "--python", sys.executable])
answer["words"] = words.getvalue()
bpy.ops.preferences.addon_disable(module=name)
answer["disabled"] = not hasattr(bpy.types.Scene, "chona")
bpy.ops.preferences.addon_enable(module=name)
answer["enabled again"] = hasattr(bpy.types.Scene, "chona")
import addon_utils  # noqa: E402 - it needs bpy to be set up

answer["warnings"] = str(getattr(addon_utils, "_extensions_warnings_get", dict)())
say(answer)
