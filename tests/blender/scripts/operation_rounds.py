"""Switches the installed extension on and off twenty times, uses it, updates it and removes it.

Arguments: the zip of an older version, the zip, a model, a folder for temporary files (which is $TMPDIR).
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import tomllib
import types
from pathlib import Path

import bpy
from bpy.utils import previews
from operation_scene import say

import addon_utils  # isort: skip - it needs bpy

sys.path[:] = [part for part in sys.path if not (Path(part) / "chona_blender").is_dir()]
older, package, model, temporary = (Path(part) for part in sys.argv[1:5])
name = "bl_ext.user_default.chona"


def handlers() -> list[str]:
    """Every function in a list of handlers."""
    lists = {key: getattr(bpy.app.handlers, key) for key in dir(bpy.app.handlers)}
    named = [(key, each) for key, found in lists.items() if isinstance(found, list) for each in found]
    return sorted(f"{key}: {each.__module__}.{each.__qualname__}" for key, each in named)


def timers() -> list[str]:
    """Functions of the add-on that wait for a timer; Blender lists none."""
    found = []
    for module in [each for key, each in sys.modules.items() if key.startswith(name)]:
        functions = [each for each in vars(module).values() if isinstance(each, types.FunctionType)]
        found += [each.__qualname__ for each in functions if bpy.app.timers.is_registered(each)]
    return sorted(found)


def snapshot() -> dict:
    """Everything that an add-on could leave behind."""
    ids = [bpy.types.Scene, bpy.types.Object, bpy.types.Bone, bpy.types.PoseBone, bpy.types.WindowManager]
    listed = subprocess.run(["ps", "-eo", "ppid=,stat=,args="], capture_output=True, text=True, check=True).stdout
    children = [line.split(None, 2)[2] for line in listed.splitlines() if line.split()[0] == str(os.getpid())]
    return {
        "classes": sorted(each for each in dir(bpy.types) if "CHONA" in each.upper()),
        "subclasses": sorted(
            each.__name__ for base in (bpy.types.Operator, bpy.types.Panel, bpy.types.PropertyGroup, bpy.types.UIList)
            for each in base.__subclasses__() if each.is_registered and "chona" in each.__module__
        ),
        "properties": [f"{each.__name__}.{p.identifier}" for each in ids for p in each.bl_rna.properties],
        "operators": [each for each in dir(bpy.ops.chona) if not each.startswith("_")],
        "handlers": handlers(),
        "timers": timers(),
        "previews": len(previews._uuid_open),
        "threads": [each.name for each in threading.enumerate()],
        "children": [each for each in children if not each.startswith("ps ")],
        "files": sorted(path.name for path in temporary.rglob("*") if not path.name.startswith("blender_")),
        "path": [part for part in sys.path if "chona" in part],
        "data": {key: len(getattr(bpy.data, key)) for key in ("scenes", "objects", "images", "texts", "node_groups")},
    }  # fmt: skip


def use(rounds: int) -> list[str]:
    """A little of what an animator does; what it puts into the file goes with the objects."""
    bpy.context.scene.chona.model_path = str(model)
    answers = [*bpy.ops.chona.create_rig()]
    if rounds == 0:  # a worker is started, and there is none that could work
        try:
            answers += [*bpy.ops.chona.check_worker()]
        except RuntimeError as error:
            answers.append(str(error).splitlines()[0])
    clear()
    return answers


def clear() -> None:
    """An empty file."""
    for each in list(bpy.data.objects):
        bpy.data.objects.remove(each)
    bpy.data.orphans_purge(do_recursive=True)


def differences(one: dict, other: dict) -> dict:
    """Where two snapshots differ."""
    return {key: [one[key], other[key]] for key in one if one[key] != other[key]}


def version() -> str:
    """Of the sources that are loaded."""
    manifest = Path(sys.modules[name].__file__).parent / "blender_manifest.toml"
    return tomllib.loads(manifest.read_text())["version"]


def install(zipped: Path) -> None:
    """As Install from Disk does, over what is there and enabled."""
    bpy.ops.extensions.package_install_files(
        filepath=str(zipped), repo="user_default", enable_on_install=True, overwrite=True
    )


clear()
before = snapshot()
install(older)
answer: dict = {"used": use(0), "older": version()}
bpy.ops.preferences.addon_disable(module=name)
first = snapshot()
answer["first"] = differences(before, first)
rounds = []
for number in range(20):
    bpy.ops.preferences.addon_enable(module=name)
    on = snapshot()
    if number % 5 == 0:
        use(number + 1)
        bpy.ops.ed.undo_push(message="used")
    bpy.ops.preferences.addon_disable(module=name)
    rounds.append(on)
answer["rounds on"] = differences(rounds[0], rounds[-1])
answer["rounds off"] = differences(first, snapshot())

bpy.ops.preferences.addon_enable(module=name)
bpy.context.preferences.addons[name].preferences.device = "cpu"
kept = Path(bpy.utils.extension_path_user(name, create=True)) / "kept"
kept.write_text("the worker's environment lies here")
install(package)
answer["updated"] = {
    "version": version(),
    "enabled": name in bpy.context.preferences.addons,
    "device": bpy.context.preferences.addons[name].preferences.device,
    "kept": kept.is_file(),
    "differences": differences(rounds[0], snapshot()),
    "warnings": str(getattr(addon_utils, "_extensions_warnings_get", dict)()),
    "used": use(1),
}
repo = next(
    index for index, each in enumerate(bpy.context.preferences.extensions.repos) if each.module == "user_default"
)
bpy.ops.extensions.package_uninstall(repo_index=repo, pkg_id="chona")
answer["uninstalled"] = {
    "differences": differences(first, snapshot()),
    "folder": kept.parent.exists(),
    "sources": (Path(bpy.utils.user_resource("EXTENSIONS")) / "user_default" / "chona").exists(),
}
say(answer)
