"""Bones and objects that are scaled, sheared, mirrored, without length or without a value."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from bpy.types import Object

from .cast import Cast
from .findings import ERROR, WARNING, Finding, frame_words
from .sampling import Samples
from .validation import STRETCH_LIMIT, figure_scale, stretches

WORTH_TELLING = 0.01
"""Scale and shear below a hundredth are not seen."""


def shape_findings(label: str, found: Cast, taken: Samples) -> Iterator[Finding]:
    """Scale, shear, mirroring and what has no length or no value."""
    driver = found.driver
    if driver is not None:
        linear = taken.world_from_armature[..., :3, :3]
        finite = linear[np.isfinite(linear).all(axis=(-1, -2))]
        size = figure_scale(finite) if len(finite) else 1.0
        armature = driver.armature.name
        refused = STRETCH_LIMIT if driver.rest is not None else np.inf
        told = _linear(label, armature, driver.bones, linear / (size or 1.0), taken.frames, refused)
        yield from _without_heirs(list(told), driver.armature)
        yield from _zero_length(label, found)
    for index, item in enumerate(found.subject.objects):
        linear = taken.world_from_object[:, index, None, :3, :3]
        size = figure_scale(linear) if np.isfinite(linear).all() and driver is None else 1.0
        yield from _linear(label, item.name, [""], linear / (size or 1.0), taken.frames, STRETCH_LIMIT)


def _without_heirs(told: list[Finding], armature: Object) -> list[Finding]:
    """Findings without those that a bone only inherits: the same thing, told of a bone above it."""
    shorts = {each.bone: (each.kind, each.frame, each.short) for each in told}

    def inherits(each: Finding) -> bool:
        above = armature.data.bones[each.bone].parent
        while above is not None and above.name not in shorts:
            above = above.parent
        return above is not None and shorts[above.name] == shorts[each.bone]

    return [each for each in told if not inherits(each)]


def _linear(
    label: str, item: str, bones: Sequence[str], linear: np.ndarray, frames: np.ndarray, refused: float
) -> Iterator[Finding]:
    """One finding a bone (or an object, with an empty name): the gravest."""
    seen = stretches(linear)
    stretch, finite, flat, mirrored = seen.values, seen.finite, seen.flat, seen.mirrored
    size = stretch.mean(axis=-1)
    shear = np.where(flat, 0.0, stretch[..., 0] / np.maximum(stretch[..., 2], 1e-12) - 1.0)
    for index, bone in enumerate(bones):
        name = f"'{bone or item}'"

        def tell(bad: np.ndarray, worst: np.ndarray, kind: str, words: str, short: str, bone: str = bone) -> Finding:
            at = int(np.where(bad, worst, -np.inf).argmax())
            whole = bad.all() and len(frames) > 1
            when = "in all frames" if whole else f"in {frame_words(frames[bad].tolist())}"
            return Finding(kind, label, item, bone, "", int(frames[at]), f"{words} {when}", short)

        one = np.ones(len(frames))
        off = np.abs(size[:, index] - 1.0)
        stretched = np.abs(stretch[:, index] - 1.0).max(axis=-1)
        kind = ERROR if stretched.max() > refused else WARNING
        if not finite[:, index].all():
            yield tell(~finite[:, index], one, ERROR, f"{name} has no finite value", "no value")
        elif flat[:, index].any():
            yield tell(flat[:, index], one, ERROR, f"{name} has zero scale", "zero scale")
        elif mirrored[:, index].any():
            yield tell(mirrored[:, index], one, ERROR, f"{name} is mirrored by a negative scale", "mirrored")
        elif shear[:, index].max() > WORTH_TELLING:
            worst = shear[:, index]
            words = f"{name} is sheared or stretched unevenly by {100 * worst.max():.0f} %"
            yield tell(worst > WORTH_TELLING, worst, kind, words, f"sheared {100 * worst.max():.0f} %")
        elif off.max() > WORTH_TELLING:
            words = f"{name} is scaled to {size[off.argmax(), index]:.2f}"
            yield tell(off > WORTH_TELLING, off, kind, words, f"scaled {size[off.argmax(), index]:.2f}")


def _zero_length(label: str, found: Cast) -> Iterator[Finding]:
    """Bones of the armature that start where the next one starts, so that nothing tells their direction."""
    driver = found.driver
    if driver is None or driver.alignment is None:
        return
    names = list(driver.skeleton.names)
    for name, link in zip(names, driver.alignment.links, strict=True):
        if link is None:
            continue
        start, end = (driver.mapping.bones[names[each]][0] for each in (link.start, link.end))
        length = np.linalg.norm(driver.heads[start] - driver.heads[end]) / driver.alignment.unit
        if length < 1e-4:
            words = f"'{start}' has no length: '{end}' starts at the same point"
            yield Finding(WARNING, label, driver.armature.name, start, name, None, words, "no length")
