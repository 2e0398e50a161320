"""A dataset whose persons and objects go by other names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from chona_model.data.dataset import Dataset, Pose


def renamed(dataset: Dataset, names: Mapping[str, str]) -> Dataset:
    """The dataset with identities called ``names[NAME]``; those that are not in ``names`` keep theirs."""

    def of(name: str) -> str:
        return names.get(name, name)

    def posed(pose: Pose) -> Pose:
        person = None if pose.person is None else of(pose.person)
        return replace(pose, person=person, objects=tuple(map(of, pose.objects)))

    return replace(
        dataset,
        persons={of(name): replace(person, name=of(name)) for name, person in dataset.persons.items()},
        objects={of(name): replace(thing, name=of(name)) for name, thing in dataset.objects.items()},
        views=tuple(replace(view, pose=posed(view.pose)) for view in dataset.views),
    )
