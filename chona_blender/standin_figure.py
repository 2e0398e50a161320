"""An armature with the figure's own proportions that follows the user's: for rigs of another body.

An armature modifier on the user's rig would bend the figure where the rig has its joints.  Bakes carry rotations and
keep the figure's lengths (``rig.retarget``); so does this armature, with constraints alone:

* Every bone copies the rotation of a *hook*, a bone that the user's bones carry as they would a vertex, and hangs on
  its parent by the figure's own length.
* The hips hang on the middle of the user's hip joints, the thighs on the line between them.
* The chest hangs where neck and shoulders are: the way there from the hips, in the figure's length.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np
from bpy.types import Object
from mathutils import Matrix, Vector

from .rig.driver import Driver
from .standin_bind import rest_frames

HOOK, JOINT = "CHONA hook ", "CHONA joint "
MIDDLE, LINE, TORSO = "CHONA hips", "CHONA hip line", "CHONA torso"
SHOULDERS, TOP, NECK, CHEST = "CHONA shoulders", "CHONA top", "CHONA neck", "CHONA chest"
SHARE = 0.05
"""Length of the bones as a share of the figure's height: nobody sees them."""


@dataclass
class _Plan:
    """Bones to make, and what moves each.

    Attributes:
        heads: bone → [3] in the armature's space; parents: bone → bone; tails: of the few bones that point somewhere.
        carried: hook → bones of the user's armature that carry it by equal shares.
        constraints: bone, kind, bone to follow, settings.
    """

    heads: dict[str, np.ndarray] = field(default_factory=dict)
    parents: dict[str, str] = field(default_factory=dict)
    tails: dict[str, np.ndarray] = field(default_factory=dict)
    carried: dict[str, tuple[str, ...]] = field(default_factory=dict)
    constraints: list[tuple[str, str, str, dict]] = field(default_factory=list)

    def follow(self, bone: str, kind: str, target: str, **settings: object) -> None:
        """Adds a constraint to another bone of this armature."""
        self.constraints.append((bone, kind, target, settings))

    def between(self, bone: str, targets: list[str]) -> None:
        """Keeps a bone in the middle of others."""
        for number, target in enumerate(targets, start=1):
            self.follow(bone, "COPY_LOCATION", target, influence=1.0 / number)


def make_figure_rig(driver: Driver, item: Object) -> None:
    """Gives an armature object, empty or made here before, the figure's bones as the user's armature rests."""
    plan = _plan(driver)
    _make_bones(item, plan)
    item.parent, item.parent_type = driver.armature, "OBJECT"
    item.matrix_parent_inverse.identity()
    item.matrix_basis.identity()
    for name, chain in plan.carried.items():
        carrier = item.pose.bones[name].constraints.new("ARMATURE")
        carrier.use_deform_preserve_volume = True  # the mean of rotations is a rotation
        for bone in chain:
            target = carrier.targets.new()
            target.target, target.subtarget, target.weight = driver.armature, bone, 1.0 / len(chain)
    for name, kind, followed, settings in plan.constraints:
        constraint = item.pose.bones[name].constraints.new(kind)
        constraint.target, constraint.subtarget = item, followed
        if kind.startswith("COPY"):
            constraint.target_space = constraint.owner_space = "POSE"
        for key, value in settings.items():
            setattr(constraint, key, value)


def _plan(driver: Driver) -> _Plan:
    names, parents = list(driver.skeleton.names), driver.skeleton.parents
    heads, parts = _heads(driver), driver.mapping.model.parts
    plan = _Plan()

    def mapped(part: str) -> int | None:
        """The first bone of a part of the body, where the user's armature has one for it."""
        chain = parts.get(part, ())
        return names.index(chain[0]) if chain and driver.mapping.bones[chain[0]] else None

    anchor = mapped("hips") or 0
    free = _upwards(parents, anchor)
    for index, name in enumerate(names):
        plan.heads[name] = heads[index]
        if index not in free:
            plan.parents[name] = names[parents[index]]
        chain = driver.mapping.bones[name] or (driver.mapping.bones[names[anchor]] if index in free else ())
        if chain:
            plan.heads[HOOK + name], plan.carried[HOOK + name] = heads[index], chain
            plan.follow(name, "COPY_TRANSFORMS" if index in free else "COPY_ROTATION", HOOK + name)
    thighs = [mapped("upper_leg.L"), mapped("upper_leg.R")]
    if None not in thighs and all(parents[each] == anchor for each in thighs):  # type: ignore[index]
        _hang_on_hips(plan, driver, names[anchor], [names[each] for each in thighs])  # type: ignore[index]
        chest = names.index(parts["spine"][-1]) if parts.get("spine") else None
        found = [mapped(part) for part in ("neck", "collar.L", "collar.R", "upper_arm.L", "upper_arm.R")]
        hung = [names[each] for each in found if each is not None and parents[each] == chest]
        if chest is not None and hung and HOOK + names[chest] in plan.heads:
            _hang_on_shoulders(plan, driver, names[anchor], names[chest], hung, [names[each] for each in thighs])  # type: ignore[index]
    return plan


def _hang_on_hips(plan: _Plan, driver: Driver, anchor: str, thighs: list[str]) -> None:
    """The hips on the middle of the user's hip joints, the thighs on the line between them."""
    joints = [_joint(plan, driver, bone) for bone in thighs]
    plan.heads[MIDDLE] = (plan.heads[joints[0]] + plan.heads[joints[1]]) / 2.0
    plan.between(MIDDLE, joints)
    plan.follow(MIDDLE, "COPY_ROTATION", HOOK + anchor)
    plan.parents[anchor] = MIDDLE
    plan.constraints = [each for each in plan.constraints if each[0] != anchor]
    plan.follow(anchor, "COPY_ROTATION", HOOK + anchor)
    if np.linalg.norm(plan.heads[joints[0]] - plan.heads[MIDDLE]) > 0.0:
        plan.heads[LINE], plan.tails[LINE], plan.parents[LINE] = plan.heads[MIDDLE], plan.heads[joints[0]], MIDDLE
        plan.follow(LINE, "DAMPED_TRACK", joints[0], track_axis="TRACK_Y")
        for bone in thighs:
            plan.parents[bone] = LINE


def _hang_on_shoulders(
    plan: _Plan, driver: Driver, anchor: str, chest: str, hung: list[str], thighs: list[str]
) -> None:  # fmt: skip
    """The chest where the user's neck and shoulder joints are, as far from the hips as the figure's torso is long."""
    joints = [_joint(plan, driver, bone) for bone in hung]
    low, high = plan.heads[MIDDLE], np.mean([plan.heads[joint] for joint in joints], axis=0)
    own = driver.skeleton.joints
    index = list(driver.skeleton.names).index
    torso = np.mean([own[index(bone)] for bone in hung], axis=0) - np.mean(
        [own[index(bone)] for bone in thighs], axis=0
    )
    found = float(np.linalg.norm(high - low))
    length = float(np.linalg.norm(torso)) * rest_scale(driver)
    if min(found, length) <= 0.0:
        return
    plan.heads[SHOULDERS] = high
    plan.between(SHOULDERS, joints)
    plan.heads[TORSO], plan.tails[TORSO], plan.parents[TORSO] = low, low + (high - low) * (length / found), MIDDLE
    plan.follow(TORSO, "STRETCH_TO", SHOULDERS, rest_length=found, volume="NO_VOLUME", keep_axis="SWING_Y")
    plan.heads[TOP] = plan.tails[TORSO]
    plan.follow(TOP, "COPY_LOCATION", TORSO, head_tail=1.0)
    plan.follow(TOP, "COPY_ROTATION", HOOK + anchor)
    neck = np.mean([plan.heads[bone] for bone in hung], axis=0)
    plan.heads[NECK], plan.parents[NECK] = neck, TOP
    plan.heads[CHEST] = neck
    plan.follow(CHEST, "COPY_LOCATION", NECK)
    plan.follow(CHEST, "COPY_ROTATION", HOOK + chest)
    plan.parents[chest] = CHEST


def _joint(plan: _Plan, driver: Driver, bone: str) -> str:
    """A hook on the head of the user's bone for a bone of the model."""
    first = driver.mapping.bones[bone][0]
    plan.heads[JOINT + bone], plan.carried[JOINT + bone] = driver.heads[first], (first,)
    return JOINT + bone


def _upwards(parents: tuple[int, ...] | list[int], index: int) -> set[int]:
    """A bone and those above it."""
    found = set()
    while index >= 0:
        found.add(index)
        index = parents[index]
    return found


def rest_scale(driver: Driver) -> float:
    """Units of the armature in a metre of the figure."""
    return rest_frames(driver, np.array(driver.armature.matrix_world, dtype=np.float64))[1] / driver.size


def _heads(driver: Driver) -> np.ndarray:
    """[B, 3] joints of the figure in the armature's space while it rests."""
    world = np.array(driver.armature.matrix_world, dtype=np.float64)
    frames, scale = rest_frames(driver, world)
    inverse = np.linalg.inv(world)
    return scale * frames[:, :3, 3] @ inverse[:3, :3].T + inverse[:3, 3]


def _make_bones(item: Object, plan: _Plan) -> None:
    """The bones, along the armature's axes; those of before go.

    They are made in a scene of their own, so that the user's modes and selection stay as they are.
    """
    length = SHARE * float(np.ptp(list(plan.heads.values()), axis=0).max() or 1.0)
    temporary = bpy.data.scenes.new("CHONA stand-in")
    hidden, item.hide_viewport = item.hide_viewport, False
    try:
        temporary.collection.objects.link(item)
        layer = temporary.view_layers[0]
        layer.objects.active = item
        layer.update()
        with bpy.context.temp_override(
            scene=temporary, view_layer=layer, object=item, active_object=item, selected_objects=[item]
        ):
            bpy.ops.object.mode_set(mode="EDIT")
            try:
                _fill(item.data.edit_bones, plan, length)
            finally:
                bpy.ops.object.mode_set(mode="OBJECT")
    finally:
        item.hide_viewport = hidden
        bpy.data.scenes.remove(temporary)


def _fill(bones: bpy.types.ArmatureEditBones, plan: _Plan, length: float) -> None:
    for bone in list(bones):
        bones.remove(bone)
    for name, head in plan.heads.items():
        bone = bones.new(name)
        bone.length = length
        if name in plan.tails:
            bone.head, bone.tail = Vector(head), Vector(plan.tails[name])
        else:
            bone.matrix = Matrix.Translation(head)
        bone.use_deform, bone.inherit_scale = not name.startswith("CHONA "), "NONE"
    for name, parent in plan.parents.items():
        bones[name].parent = bones[parent]
