"""``chona check-data``: draws what a reader understood over the images, and measures whether it fits.

A wrong convention (a transposed rotation, y up for y down, half a pixel, millimetres) is invisible in arrays and plain
in a picture.  The numbers say the same for a farm's log: how many joints fall into the person's mask, and objects'
centres into the object's.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import binary_dilation, binary_erosion

from chona_model.data.dataset import Dataset, DatasetError, ObjectShape, View
from chona_model.data.images import load_pixels, opened_image
from chona_model.data.soundness import check_view
from chona_model.progress import Progress
from chona_model.skeleton import Skeleton

SLACK = 0.02
"""Share of the image's width that joints may lie outside the mask (joints of hidden limbs and of loose fits do)."""
JOINT_SHARE_EXPECTED = 0.7
"""Below it the poses and the masks hardly belong together (the benchmark capture has 1.0)."""
OBJECT_SHARE_EXPECTED = 0.7
MIN_OBJECT_PIXELS = 50
TILE_WIDTH = 320
SHEET_COLUMNS = 3
_PERSON, _OBJECT, _BONE, _BOX = (80, 220, 120), (255, 170, 40), (255, 60, 90), (70, 170, 255)
_EDGES = ((0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7), (6, 7))


@dataclass(frozen=True)
class SequenceCheck:
    """What was measured in one sequence.

    Attributes:
        name: of the sequence.
        views: how many the dataset has; checked: how many were opened.
        joints_inside: share of projected joints inside the masks (person or object, slack added); None without person.
        objects_inside: share of projected object centres inside the object mask's box; None without visible object.
        sheet: picture of the checked views, None when none was asked for.
    """

    name: str
    views: int
    checked: int
    joints_inside: float | None
    objects_inside: float | None
    sheet: Path | None


@dataclass(frozen=True)
class DataReport:
    """What ``check_data`` found.

    Attributes:
        persons, objects: names.
        bones: of the skeleton.
        views: in the dataset.
        gaps: what the reader skipped, by kind.
        sequences: measurements.
        warnings: sentences that say what looks wrong and what to look at; damaged files are among them.
    """

    persons: tuple[str, ...]
    objects: tuple[str, ...]
    bones: int
    views: int
    gaps: dict[str, int]
    sequences: tuple[SequenceCheck, ...]
    warnings: tuple[str, ...]


@dataclass
class _Tally:
    """Hits and misses of one sequence while its views are looked at."""

    joints: list[float] = field(default_factory=list)
    objects: list[float] = field(default_factory=list)
    behind: int = 0
    tiles: list[Image.Image] = field(default_factory=list)


def check_data(
    dataset: Dataset, out_dir: Path | None, views_per_sequence: int = 8, progress: Progress | None = None
) -> DataReport:
    """Opens some views of every sequence, draws and measures them.

    Args:
        out_dir: where ``SEQUENCE.png`` goes; None draws nothing.
        views_per_sequence: how many views are opened, spread over frames and cameras; 0 opens no file.
        progress: told of every sequence.

    Raises:
        OSError: a picture cannot be written.
        Cancelled: the user wanted an end; pictures so far stay.
    """
    by_sequence: dict[str, list[View]] = defaultdict(list)
    for view in dataset.views:
        by_sequence[view.sequence].append(view)
    checks, warnings = [], [f"{count} x {kind} missing" for kind, count in sorted(dataset.gaps.items())]
    if progress is not None:
        progress.start("check-data", len(by_sequence), unit="sequence")
    for number, (name, views) in enumerate(by_sequence.items()):
        if progress is not None:
            progress.check()
            progress.update(number, name)
        chosen = _spread(views, views_per_sequence)
        tally = _Tally()
        for view in chosen:
            try:
                _look(dataset, view, tally, out_dir is not None)
            except DatasetError as error:
                warnings.append(str(error))
        sheet = None
        if out_dir is not None and tally.tiles:
            sheet = out_dir / f"{name}.png"
            sheet.parent.mkdir(parents=True, exist_ok=True)
            unfinished = sheet.with_name(f".{name}.tmp.png")
            _sheet(tally.tiles).save(unfinished)
            unfinished.replace(sheet)
        joints, objects = (float(np.mean(values)) if values else None for values in (tally.joints, tally.objects))
        checks.append(SequenceCheck(name, len(views), len(chosen), joints, objects, sheet))
        warnings.extend(_doubts(checks[-1], tally))
    return DataReport(
        tuple(dataset.persons),
        tuple(dataset.objects),
        len(dataset.skeleton),
        len(dataset.views),
        dict(dataset.gaps),
        tuple(checks),
        tuple(warnings),
    )


def _doubts(check: SequenceCheck, tally: _Tally) -> Iterable[str]:
    where = f"{check.name}: " if check.sheet is None else f"{check.name} ({check.sheet.name}): "
    if tally.behind:
        yield (
            f"{where}in {tally.behind} views the person or object is behind the camera; is the camera pose the inverse "
            "(world to camera), or its axes OpenGL's (y up, looking along -z)?"
        )
    elif check.joints_inside is not None and check.joints_inside < JOINT_SHARE_EXPECTED:
        yield (
            f"{where}only {check.joints_inside:.0%} of the joints fall into the masks, expected over "
            f"{JOINT_SHARE_EXPECTED:.0%}; do images, masks and calibration have one size, and poses and cameras one "
            "world, unit (metres) and axes?"
        )
    if check.objects_inside is not None and check.objects_inside < OBJECT_SHARE_EXPECTED:
        yield (
            f"{where}only {check.objects_inside:.0%} of the objects' centres fall into the box of their mask; is "
            "the object's frame at its template's centre, and its rotation not transposed?"
        )


def _spread(views: Sequence[View], count: int) -> list[View]:
    """Views at even steps, with other cameras from frame to frame."""
    if len(views) <= count or count < 1:
        return list(views[:count])
    return [views[round(index)] for index in np.linspace(0, len(views) - 1, count)]


def _look(dataset: Dataset, view: View, tally: _Tally, draw: bool) -> None:
    check_view(dataset, view)
    pixels = load_pixels(view)
    height, width = pixels.mask.shape
    if view.pose.person is not None:
        position, depth = view.camera.project(view.pose.world_from_bone[:, :3, 3])
        tally.behind += int((depth <= 0).all())
        # Limbs reach behind the object, so its mask counts too; joints outside the picture say nothing.
        near = binary_dilation(pixels.mask, iterations=max(1, round(SLACK * width)))
        seen = (depth > 0) & (position >= 0).all(1) & (position < (width, height)).all(1)
        column, row = position[seen].astype(int).T
        tally.joints.extend(near[row, column].astype(float))
    rows, columns = np.flatnonzero(pixels.object.any(1)), np.flatnonzero(pixels.object.any(0))
    for frame in view.pose.world_from_object:
        position, depth = view.camera.project(frame[:3, 3])
        tally.behind += int(depth <= 0)
        # A sliver behind the person tells nothing of where the centre is.
        if pixels.object.sum() > MIN_OBJECT_PIXELS:
            inside = columns[0] <= position[0] <= columns[-1] + 1 and rows[0] <= position[1] <= rows[-1] + 1
            tally.objects.append(float(inside and depth > 0))
    if draw:
        tally.tiles.append(draw_view(dataset, view))


def draw_view(dataset: Dataset, view: View, width: int = TILE_WIDTH) -> Image.Image:
    """The image with mask outlines, bones and object boxes over it, ``width`` pixels wide."""
    scale = width / view.camera.width
    camera = view.camera.scaled(scale)
    pixels = load_pixels(view, scale) if scale <= 1.0 else load_pixels(view)
    with opened_image(view.image) as source:
        picture = np.asarray(source.convert("RGB").resize((camera.width, camera.height), Image.Resampling.BOX)).copy()
    if scale <= 1.0:
        for mask, colour in ((pixels.person, _PERSON), (pixels.object, _OBJECT)):
            picture[mask & ~binary_erosion(mask)] = colour
    tile = Image.fromarray(picture)
    pen = ImageDraw.Draw(tile)
    if view.pose.person is not None:
        bones = bone_segments(dataset.skeleton, view.pose.world_from_bone)
        _draw_segments(pen, camera.project(bones), _BONE)
    for name, frame in zip(view.pose.objects, view.pose.world_from_object, strict=True):
        corners = box_corners(dataset.objects[name]) @ frame[:3, :3].T + frame[:3, 3]
        edges = np.array([[corners[start], corners[end]] for start, end in _EDGES])
        _draw_segments(pen, camera.project(edges), _BOX)
    pen.text((3, 2), f"{view.frame} {view.camera_name}", fill=(255, 255, 255), stroke_width=1, stroke_fill=(0, 0, 0))
    return tile


def bone_segments(skeleton: Skeleton, world_from_bone: np.ndarray) -> np.ndarray:
    """[B - 1, 2, 3] from every joint's parent to the joint, world, metres."""
    joints = world_from_bone[:, :3, 3]
    pairs = [(joints[parent], joints[index]) for index, parent in enumerate(skeleton.parents) if parent >= 0]
    return np.array(pairs).reshape(-1, 2, 3)


def box_corners(shape: ObjectShape) -> np.ndarray:
    """[8, 3] corners in the object's frame; corner k takes the upper x, y, z by k's bits 4, 2, 1."""
    return np.array([np.where([k & 4, k & 2, k & 1], shape.upper, shape.lower) for k in range(8)])


def _draw_segments(
    pen: ImageDraw.ImageDraw, projected: tuple[np.ndarray, np.ndarray], colour: tuple[int, int, int]
) -> None:
    """Lines between pairs of projected points, those behind the camera left out."""
    for (start, end), depths in zip(*projected, strict=True):
        if (depths > 0).all() and np.abs((start, end)).max() < 1e5:
            pen.line([tuple(start), tuple(end)], fill=colour, width=2)


def _sheet(tiles: Sequence[Image.Image]) -> Image.Image:
    columns = min(SHEET_COLUMNS, len(tiles))
    height = max(tile.height for tile in tiles)
    sheet = Image.new("RGB", (columns * TILE_WIDTH, -(-len(tiles) // columns) * height))
    for index, tile in enumerate(tiles):
        sheet.paste(tile, (index % columns * TILE_WIDTH, index // columns * height))
    return sheet
