"""What a rigid body simulation moves, and playing it through.

A simulation goes on from frame to frame in its own scene; the temporary scene of ``sampling`` has none.  So where what
is sampled hangs on one, the user's scene is played from the simulation's first frame, and put back afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import bpy
from bpy.types import Depsgraph, Object, PoseBone, Scene

_CHANNELS = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")


def simulated(scene: Scene, objects: Iterable[Object]) -> Object | None:
    """The first object that the scene's rigid body simulation moves among ``objects`` and all that they depend on."""
    world = scene.rigidbody_world
    if world is None or not world.enabled or world.collection is None:
        return None
    bodies = [each for each in world.collection.objects if each.rigid_body is not None]
    moving = {each for each in bodies if each.rigid_body.type == "ACTIVE" and not each.rigid_body.kinematic}
    pending, seen = list(objects), set()
    while pending and moving:
        each = pending.pop()
        if each is None or each in seen:
            continue
        if each in moving:
            return each
        seen.add(each)
        pending.extend(_depends_on(each))
    return None


def _depends_on(item: Object) -> Iterator[Object | None]:
    """Parent, targets of constraints and of drivers."""
    yield item.parent
    owners: list[Object | PoseBone] = [item, *(item.pose.bones if item.pose else ())]
    for owner in owners:
        for constraint in owner.constraints:
            yield getattr(constraint, "target", None)
            for target in getattr(constraint, "targets", ()):
                yield target.target
    for driven in item.animation_data.drivers if item.animation_data else ():
        for variable in driven.driver.variables:
            yield from (target.id for target in variable.targets if isinstance(target.id, bpy.types.Object))


@contextmanager
def played(scene: Scene, kept: Iterable[Object]) -> Iterator[Callable[[float], Depsgraph]]:
    """A function that plays the scene up to a time in frames and gives its evaluated depsgraph.

    Between frames, and at times before the last, the simulation stands as its cache has it.

    Afterwards the scene stands at its frame again, with un-keyed edits of the objects and bones ``kept``.
    """
    layer = bpy.context.view_layer if scene == bpy.context.scene else scene.view_layers[0]
    frame, subframe = scene.frame_current, scene.frame_subframe
    owners = [owner for each in kept for owner in (each, *(each.pose.bones if each.pose else ()))]
    before = [(owner, {name: tuple(getattr(owner, name)) for name in _CHANNELS}) for owner in owners]
    at = scene.rigidbody_world.point_cache.frame_start - 1
    stands: float | None = None

    def show(time: float) -> None:
        nonlocal stands
        whole = math.floor(time)
        scene.frame_set(whole, subframe=time - whole)
        stands = time

    def advance(time: float) -> Depsgraph:
        nonlocal at
        if at < math.ceil(time) and stands not in (None, at):
            show(at)  # a simulation goes on from the frame it was played to
        while at < math.ceil(time):
            at += 1
            show(at)
        if stands != time:
            show(time)
        return layer.depsgraph

    try:
        yield advance
    finally:
        scene.frame_set(frame, subframe=subframe)
        for owner, channels in before:
            for name, value in channels.items():
                if tuple(getattr(owner, name)) != value:
                    setattr(owner, name, value)
