"""The systems that the paper compares, as settings of one: what of an object's motion the model is told, and whether
identity codes are exchanged.

==================  ============================================================================================
chona               the pseudo bone moves the object, and compositional invariant learning separates the codes
no-cil              the same without compositional invariant learning
separate            as no-cil, with each part conditioned on its own code alone: the codes cannot depend on each other
joint               as chona, with one table for all persons and one for all objects: the paper's joint field
joint-no-cil        the same without compositional invariant learning
object-translation  the paper's baseline: the object's place is known and its rotation is not
tava                no pseudo bone: what is held is a part of the person, moved by the body's bones alone
arah                as tava, and the density comes from a signed distance that begins as the body's
arah-object         as arah, with the pseudo bone (the paper's ARAH*)
==================  ============================================================================================

What differs from ARAH itself: its prior is a network that was trained on many dressed scans, here it is the distance to
the capture's body model (to capsules around the bones where there is none, to an ellipsoid for objects); its surface is
found by joint root finding and rendered around it, here the density of the distance is integrated along the whole ray,
through the same correspondences as all other methods'.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from chona_model.data.dataset import Dataset, ObjectShape, View

HELD_REACH = 0.9
"""Metres beyond the body in which a person may hold what has no bone of its own."""


@dataclass(frozen=True)
class Method:
    """One system.

    Attributes:
        name: on the command line and in model files.
        objects: ``rigid``: pseudo bones; ``placed``: they move and never turn; ``none``: there are none.
        invariant_codes: whether training draws the other part's code at random (CIL).
        distances: whether the density comes from a signed distance, with the eikonal loss and the body as its start.
        joint: whether identities share tables and are told apart by their codes alone.
        own_codes: whether what a person looks like is told its own code alone, and an object the same.
    """

    name: str
    objects: Literal["rigid", "placed", "none"] = "rigid"
    invariant_codes: bool = True
    distances: bool = False
    joint: bool = False
    own_codes: bool = False

    @property
    def reach(self) -> float:
        """Metres beyond its body that a person's canonical space has to hold."""
        return HELD_REACH if self.objects == "none" else 0.0

    def dataset(self, dataset: Dataset) -> Dataset:
        """The capture as the method sees it; views that have nothing to show any more are left out.

        ``none``: objects belong to the person, masks and all. ``placed``: an object that turns inside its box needs
        the ball around it.
        """
        if self.objects == "rigid":
            return dataset
        if self.objects == "placed":
            return replace(dataset, objects={name: _turned_anyhow(thing) for name, thing in dataset.objects.items()})
        views = tuple(_of_the_person(view) for view in dataset.views if view.pose.person is not None)
        return replace(dataset, objects={}, views=views)


METHODS = {
    method.name: method
    for method in (
        Method("chona"),
        Method("no-cil", invariant_codes=False),
        Method("separate", invariant_codes=False, own_codes=True),
        Method("joint", joint=True),
        Method("joint-no-cil", invariant_codes=False, joint=True),
        Method("object-translation", objects="placed"),
        Method("tava", objects="none", invariant_codes=False),
        Method("arah", objects="none", invariant_codes=False, distances=True),
        Method("arah-object", invariant_codes=False, distances=True),
    )
}


def method_of(name: str) -> Method:
    """The method that a model file names.

    Raises:
        ValueError: it is none of this version's.
    """
    if name not in METHODS:
        raise ValueError(f"the model's method is '{name}', this version has {', '.join(METHODS)}: update it")
    return METHODS[name]


def _turned_anyhow(thing: ObjectShape) -> ObjectShape:
    radius = float(np.linalg.norm(np.maximum(np.abs(thing.lower), np.abs(thing.upper))))
    return ObjectShape(thing.name, np.full(3, -radius), np.full(3, radius))


def _of_the_person(view: View) -> View:
    pose = replace(view.pose, objects=(), world_from_object=np.empty((0, 4, 4)))
    held = () if view.object_mask is None else (view.object_mask,)
    return replace(view, pose=pose, object_mask=None, held_masks=(*view.held_masks, *held))
