"""Whether numbers from a capture can be trained on at all: every refusal names the view, the part and the number.

Readers check what they parse, but datasets are also made and changed in memory; one NaN in a camera, a pose or a pixel
turns up as a ruined model an hour later, with nothing left that says where it came from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from chona_model.data.dataset import Dataset, DatasetError, View
from chona_model.data.images import Pixels

ADVICE = "look at the capture with 'chona check-data'"


def check_dataset(dataset: Dataset) -> None:
    """Looks at identities, cameras and poses; opens no image.

    Raises:
        DatasetError: no view, a number that is not finite, a box without extent, a view of somebody unknown, or an
            identity that no view has.
    """
    if not dataset.views:
        raise DatasetError("there is not one view to train on; check the folder and --sequences with check-data")
    for name, person in dataset.persons.items():
        _finite(person.rest_joints, f"the rest joints of '{name}'")
        if person.surface is not None:
            _finite(person.surface.vertices, f"the surface of '{name}'")
            _finite(person.surface.weights, f"the skinning weights of '{name}'")
    for name, thing in dataset.objects.items():
        _finite(np.stack([thing.lower, thing.upper]), f"the box of '{name}'")
        if not (np.asarray(thing.lower) < np.asarray(thing.upper)).all():
            raise DatasetError(
                f"the box of '{name}' reaches from {thing.lower} to {thing.upper}: empty; expected metres, lower first"
            )
    for view in dataset.views:
        check_view(dataset, view)
    _all_used(dataset.persons, [view.pose.person for view in dataset.views], "person")
    _all_used(dataset.objects, [name for view in dataset.views for name in view.pose.objects], "object")


def check_view(dataset: Dataset, view: View) -> None:
    """Looks at the camera and the pose of one view.

    Raises:
        DatasetError: a number that is not finite, a shape that does not fit, or an identity that is not known.
    """
    pose, label = view.pose, view.label
    _finite(view.camera.intrinsics, f"the intrinsics of the camera of view {label}")
    _finite(view.camera.world_from_camera, f"the camera pose (world_from_camera) of view {label}")
    unknown = [name for name in pose.shown if name not in dataset.persons and name not in dataset.objects]
    if unknown or not pose.shown:
        shown = f"'{unknown[0]}', of whom the capture knows nothing" if unknown else "neither a person nor an object"
        raise DatasetError(f"view {label} shows {shown}; correct the capture, or leave the sequence out")
    bones, objects = np.asarray(pose.world_from_bone), np.asarray(pose.world_from_object)
    if pose.person is not None:
        _shaped(bones, (len(dataset.skeleton), 4, 4), f"bones of view {label}")
        for index in np.flatnonzero(~np.isfinite(bones).all(axis=(1, 2)))[:1]:
            _finite(bones[index], f"the pose of bone '{dataset.skeleton.names[index]}' in view {label}")
    _shaped(objects, (len(pose.objects), 4, 4), f"objects of view {label}")
    for index in np.flatnonzero(~np.isfinite(objects).all(axis=(1, 2)))[:1]:
        _finite(objects[index], f"the pose of object '{pose.objects[index]}' in view {label}")


def check_pixels(view: View, pixels: Pixels) -> None:
    """Looks at the pixels of one view.

    Raises:
        DatasetError: colours that are not finite or outside 0…1, or masks that are not disjoint truth values of the
            camera's size.
    """
    size, label = (view.camera.height, view.camera.width), view.label
    for array, shape, name in (
        (pixels.rgb, (*size, 3), "image"), (pixels.person, size, "person mask"), (pixels.object, size, "object mask"),
    ):  # fmt: skip
        _shaped(array, shape, f"the {name} of view {label}")
    _finite(pixels.rgb, f"the image of view {label}")
    if pixels.rgb.min() < 0.0 or pixels.rgb.max() > 1.0:
        raise DatasetError(
            f"the image of view {label} holds {pixels.rgb.min():.6g} to {pixels.rgb.max():.6g}, expected sRGB values "
            f"in 0…1; {ADVICE}"
        )
    for mask, name in ((pixels.person, "person"), (pixels.object, "object")):
        if mask.dtype != np.bool_:
            raise DatasetError(
                f"the {name} mask of view {label} holds {mask.dtype} values, expected true and false; threshold it"
            )
    both = int((pixels.person & pixels.object).sum())
    if both:
        raise DatasetError(f"{both} pixels of view {label} are in the person's and the object's mask at once; {ADVICE}")


def check_seen(dataset: Dataset, views: Sequence[View], pixels: Sequence[Pixels], scale: float) -> None:
    """Whether every identity has at least one pixel in some mask: what has none would be learned as empty space.

    Args:
        views, pixels: all of the dataset's, in one order; scale: of the images, for the message.

    Raises:
        DatasetError: with the names of the identities.
    """
    seen: dict[str, int] = dict.fromkeys([*dataset.persons, *dataset.objects], 0)
    for view, image in zip(views, pixels, strict=True):
        if view.pose.person is not None:
            seen[view.pose.person] += int(image.person.sum())
        for name in view.pose.objects:
            seen[name] += int(image.object.sum())
    missing = [name for name, count in seen.items() if count == 0]
    if missing:
        height, width = pixels[0].mask.shape
        small = f"; at image scale {scale:g} they are {width}x{height} pixels: use a larger one" if scale < 1.0 else ""
        raise DatasetError(
            f"the masks leave no room for {', '.join(missing)}: not one pixel in {len(views)} views{small}; {ADVICE}, "
            "or leave those sequences out"
        )


def _finite(array: np.ndarray, name: str) -> None:
    wrong = ~np.isfinite(array)
    if wrong.any():
        place = tuple(int(index) for index in np.argwhere(wrong)[0])
        raise DatasetError(
            f"{name} holds {int(wrong.sum())} of {wrong.size} values that are not finite (first: "
            f"{np.asarray(array)[place]} at {list(place)}); expected numbers, {ADVICE} or leave it out"
        )


def _shaped(array: np.ndarray, shape: tuple[int, ...], name: str) -> None:
    if np.shape(array) != shape:
        raise DatasetError(f"{name}: an array of shape {np.shape(array)}, expected {shape}; {ADVICE}")


def _all_used(identities: Mapping[str, object], used: Sequence[str | None], kind: str) -> None:
    unused = [name for name in identities if name not in used]
    if unused:
        raise DatasetError(
            f"no view has the {kind} {', '.join(unused)}: nothing of it can be learned; add a sequence that shows it, "
            "or leave it out of the dataset"
        )
