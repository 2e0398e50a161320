"""`chona stand-in` for `blender --command`."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import bpy

from . import messages, standin
from .command_parts import DONE, run, save, say
from .errors import ChonaError
from .standin_properties import USES


def add_options(
    add: Callable[[str, str], argparse.ArgumentParser], shared: Callable[[argparse.ArgumentParser], None]
) -> None:
    """Describe the command to the parser of `command_line`; `shared` adds the options for an actor and the worker."""
    one = add("stand-in", "Make meshes of the selected actor for viewport, shadows and reflections, or remove them.")
    shared(one)
    one.add_argument("--voxel", type=float, metavar="M", help="how fine they are, metres (default: the settings')")
    uses = [each[0].lower() for each in USES]
    one.add_argument("--use", choices=uses, help="what renders see of them (default: the settings')")
    one.add_argument("--all", action="store_true", help="of every actor that is rendered")
    one.add_argument("--remove", action="store_true", help="remove them instead")


def stand_in(scene: bpy.types.Scene, arguments: argparse.Namespace) -> int:
    """0 made or removed; 1 failed or cancelled; 2 it cannot start."""
    settings = scene.chona
    actors = settings.used_actors() if arguments.all else [settings.ensure_actor()]
    if not actors:
        raise ChonaError("there is nobody to make a stand-in of: every actor is switched off")
    for actor in actors:
        if arguments.remove:
            say(f"chona: removed {standin.remove_stand_in(actor)} meshes of {actor.label}")
            continue
        if arguments.voxel is not None:
            actor.stand_in.voxel = arguments.voxel
        if arguments.use is not None:
            standin.set_use(actor, arguments.use.upper())
        job = standin.start_stand_in(scene, actor)
        code = run(job)
        if code != DONE:
            return code
        made = standin.finish_stand_in(job)
        say(f"chona: {messages.sentence(ChonaError('made ' + ', '.join(item.name for item in made)))}")
    return save(arguments)


RUNS = {"stand-in": stand_in}
