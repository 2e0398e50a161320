"""What is wrong with actors, bone by bone and frame by frame, before any time is spent on rendering."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from bpy.types import Scene

from ..errors import ChonaError
from .cast import ActorPlan, Cast, cast, unique_labels
from .check_shape import shape_findings
from .findings import ERROR, INFO, WARNING, Finding, frame_words
from .mapping import FOLLOW, map_rig
from .pose_distance import pose_distance, read_poses_seen
from .rigid import RigidPose
from .sampling import Progress, Samples, frame_list, sample_all, stored_overrides
from .validation import STRETCH_LIMIT

PLACED_WITHIN = 0.02
"""Metres; a hand or foot that lands farther from the animator's is told."""

LEGS_WITHIN = 0.03
"""Legs that differ less in length stand on the same ground."""

_ENDS = {
    "hand.L": "left hand", "hand.R": "right hand", "foot.L": "left foot", "foot.R": "right foot", "head": "head",
}  # fmt: skip


@dataclass(frozen=True)
class Strip:
    """Quality to be expected over the frames.

    Attributes:
        actor: its label.
        frames: [F]; level: [F] 0 as in training … 1 far from it; empty where the model has no record.
        words: a line that says how it stands.
    """

    actor: str
    frames: np.ndarray
    level: np.ndarray
    words: str


@dataclass(frozen=True)
class Report:
    """All findings, the worst first, and a strip for every person."""

    findings: tuple[Finding, ...]
    strips: tuple[Strip, ...]
    frames: tuple[int, int]


def check(scene: Scene, plans: Sequence[ActorPlan], frames: Iterable[int], progress: Progress | None = None) -> Report:
    """Looks at actors over frames.  What is wrong with one does not hide what is wrong with another.

    Raises:
        ChonaError: there are no frames.
    """
    numbers = frame_list(frames)
    findings: list[Finding] = []
    strips: list[Strip] = []
    good: list[tuple[str, Cast]] = []
    for label, plan in zip(unique_labels(plans), plans, strict=True):
        unmapped = list(_mapping(label, plan))
        findings += unmapped
        try:
            good.append((label, cast(plan)))
        except ChonaError as error:
            if not any(each.kind == ERROR for each in unmapped):
                item = plan.armature.name if plan.armature is not None else ""
                findings.append(Finding(ERROR, label, item, "", "", None, str(error)))
    try:
        samples = sample_all(scene, [each.subject for _, each in good], frames=numbers, progress=progress)
    except ChonaError as error:
        findings.append(Finding(ERROR, "", "", "", "", None, str(error)))
        good, samples = [], []
    for (label, found), taken in zip(good, samples, strict=True):
        shape = list(shape_findings(label, found, taken))
        findings += shape
        try:
            pose = _pose(found, taken)
        except ChonaError as error:
            if not any(each.kind == ERROR for each in shape):
                findings.append(Finding(ERROR, label, "", "", "", None, str(error)))
            continue
        if found.driver is not None:
            findings += _ends(label, found, taken, pose)
            findings += _legs(label, found)
            seen, strip = _seen(label, found, taken, pose)
            findings += seen
            strips.append(strip)
    order = [ERROR, WARNING, INFO]
    findings.sort(key=lambda each: order.index(each.kind))
    return Report(tuple(findings), tuple(strips), (int(numbers[0]), int(numbers[-1])))


def _mapping(label: str, plan: ActorPlan) -> Iterator[Finding]:
    """Bones that nothing moves."""
    armature = plan.armature
    if plan.person is None or armature is None or armature.type != "ARMATURE":
        return
    chosen = {**stored_overrides(armature), **plan.bones}
    for bone, target in list(chosen.items()):
        if target and target != FOLLOW and target not in armature.data.bones:
            words = f"'{bone}' is mapped to '{target}', which the armature does not have"
            yield Finding(ERROR, label, armature.name, "", bone, None, words, "no such bone")
            del chosen[bone]
    mapping = map_rig(armature, plan.header.names, chosen)
    for bone in mapping.problems:
        words = f"Nothing moves '{bone}': choose a bone for it"
        yield Finding(ERROR, label, armature.name, "", bone, None, words, "no bone")
    followers = [bone for bone, found in mapping.bones.items() if not found and bone not in mapping.problems]
    if followers:
        words = ", ".join(followers[:4]) + (f" and {len(followers) - 4} more" if len(followers) > 4 else "")
        words = f"Without a bone, kept to the parent: {words}"
        yield Finding(INFO, label, armature.name, "", followers[0], None, words, "kept to parent")


def _pose(found: Cast, taken: Samples) -> RigidPose:
    if found.driver is None:
        return RigidPose(np.empty((len(taken.frames), 0, 4, 4)), taken.world_from_object, 1.0, ())
    return found.driver.pose(taken, found.object_names, limit=STRETCH_LIMIT, object_limit=None, stretched=True)


def _ends(label: str, found: Cast, taken: Samples, pose: RigidPose) -> Iterator[Finding]:
    """Hands, feet and head that do not land where the animator's are, though the body has the model's proportions."""
    driver = found.driver
    if driver is None or driver.alignment is None or not driver.alignment.same_body:
        return
    names, sampled = list(driver.skeleton.names), list(driver.bones)
    for part, words in _ENDS.items():
        chain = driver.mapping.model.parts.get(part)
        bones = driver.mapping.bones[chain[0]] if chain else ()
        if not chain or not bones:
            continue
        world = taken.world_from_armature[:, sampled.index(bones[0])]
        there = world[:, :3, :3] @ driver.heads[bones[0]] + world[:, :3, 3]
        here = pose.world_from_bone[:, names.index(chain[0]), :3, 3] * pose.scale
        away = np.linalg.norm(here - there, axis=-1)
        if away.max() > PLACED_WITHIN:
            when = frame_words(taken.frames[away > PLACED_WITHIN].tolist())
            text = f"The {words} is up to {100 * away.max():.0f} cm from the rig's in {when}: it stretches too far"
            frame = int(taken.frames[away.argmax()])
            short = f"{100 * away.max():.0f} cm away"
            yield Finding(WARNING, label, driver.armature.name, bones[0], chain[0], frame, text, short)


def _legs(label: str, found: Cast) -> Iterator[Finding]:
    """Legs of another length than the armature's, where the hips do not make up for it."""
    driver = found.driver
    if driver is None or driver.alignment is None or driver.legs_scale or driver.alignment.same_body:
        return
    names = list(driver.skeleton.names)
    parts = [driver.mapping.model.parts.get(f"{part}.L") for part in ("upper_leg", "lower_leg", "foot")]
    chain = [each[0] for each in parts if each and driver.mapping.bones[each[0]]]
    if len(chain) < len(parts):
        return
    own = driver.skeleton.joints[[names.index(name) for name in chain]]
    rigs = np.array([driver.heads[driver.mapping.bones[name][0]] for name in chain]) * driver.size
    lengths = [float(np.linalg.norm(np.diff(each, axis=0), axis=1).sum()) for each in (own, rigs)]
    off = lengths[1] / max(lengths[0], 1e-9) - 1.0
    if abs(off) > LEGS_WITHIN:
        way = "longer" if off > 0 else "shorter"
        words = (
            f"The rig's legs are {100 * abs(off):.0f} % {way} than the figure's: set Path to Scaled by Legs, or its "
            "feet will not stand where the rig's do"
        )
        bone = driver.mapping.bones[chain[0]][0]
        yield Finding(INFO, label, driver.armature.name, bone, chain[0], None, words, "other legs")


def _seen(label: str, found: Cast, taken: Samples, pose: RigidPose) -> tuple[list[Finding], Strip]:
    """Joints outside the training poses, and the strip."""
    driver, header = found.driver, found.plan.header
    seen = read_poses_seen(header.raw)
    nothing = np.empty(0)
    if driver is None or seen is None or not set(seen.bones) <= set(header.names):
        return [], Strip(label, taken.frames[:0], nothing, "the model has no record of its training poses")
    result = pose_distance(seen, header.names, header.parents, pose.world_from_bone)
    findings = []
    for index in np.argsort(-result.outside.max(axis=0)):
        outside = result.outside[:, index]
        if outside.max() <= 0.0:
            break
        name = seen.bones[index]
        bones = driver.mapping.bones[name]
        degrees = np.degrees(outside.max())
        when = frame_words(taken.frames[outside > 0.0].tolist())
        frame, bone = int(taken.frames[outside.argmax()]), bones[0] if bones else ""
        words = f"'{bone or name}' is turned {degrees:.0f}° further than in any pose the model has seen, in {when}"
        findings.append(
            Finding(WARNING, label, driver.armature.name, bone, name, frame, words, f"{degrees:.0f}° unseen")
        )
    far = taken.frames[result.level > 0.0]
    words = f"{frame_words(far.tolist())} outside the training poses" if len(far) else "as in the training poses"
    return findings, Strip(label, taken.frames, result.level, words)
