"""An actor as the user describes it, and all that is found for it in the scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bpy.types import Object

from ..errors import ChonaError
from ..model_header import ModelHeader
from .driver import Driver, make_driver
from .sampling import Subject, stored_overrides


@dataclass(frozen=True)
class ActorPlan:
    """Who is to be rendered and what moves them.

    Attributes:
        header: of the model.
        person: of the model; None for objects alone.
        armature: poses the person.
        objects: the model's objects → what moves each; any object with a transform.
        bones: the user's mapping, model bone → armature bone or ``mapping.FOLLOW``.
        legs_scale: the hips' path is scaled as the figure's legs are longer or shorter than the armature's.
        name: what the scene calls the actor; empty takes the armature's name.
    """

    header: ModelHeader
    person: str | None
    armature: Object | None
    objects: Mapping[str, Object | None]
    bones: Mapping[str, str] = field(default_factory=dict)
    legs_scale: bool = False
    name: str = ""

    @property
    def label(self) -> str:
        """What people call it."""
        armature = self.armature.name if self.armature is not None and self.person else ""
        return self.name or armature or self.person or "objects"


@dataclass(frozen=True)
class Cast:
    """An actor whose parts have been found."""

    plan: ActorPlan
    driver: Driver | None
    subject: Subject
    object_names: tuple[str, ...]


def cast(plan: ActorPlan) -> Cast:
    """Finds bones and objects.

    Raises:
        ChonaError: no armature, bones that map to nothing, an object of the model without one in the scene, or neither.
    """
    placed = _placed(plan)
    driver = None
    if plan.person is not None:
        joints = plan.header.rest_joints(plan.person)
        if plan.armature is None:
            raise ChonaError(f"Person '{plan.person}' has no armature. Create a rig for it or choose an armature")
        chosen = {**stored_overrides(plan.armature), **plan.bones}
        driver = make_driver(
            plan.armature, plan.header.names, plan.header.parents, joints, chosen, legs_scale=plan.legs_scale
        )
    elif not placed:
        raise ChonaError("The shot has neither a person nor an object. Choose a person, an object or both")
    subject = Subject(plan.armature if driver else None, driver.bones if driver else (), placed)
    return Cast(plan, driver, subject, tuple(plan.objects))


def unique_labels(plans: Sequence[ActorPlan]) -> list[str]:
    """A name for each actor, no two the same."""
    labels: list[str] = []
    for plan in plans:
        label, number = plan.label, 2
        while label in labels:
            label, number = f"{plan.label} {number}", number + 1
        labels.append(label)
    return labels


def _placed(plan: ActorPlan) -> list[Object]:
    placed = []
    for name, item in plan.objects.items():
        plan.header.extents(name)
        if item is None:
            raise ChonaError(f"Object '{name}' has no empty. Create a rig with it or choose an empty for it")
        placed.append(item)
    return placed
