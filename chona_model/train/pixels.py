"""Training pixels: those that the posed hull can reach, with their depth spans, grouped by pose and view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from chona_model.camera import Camera
from chona_model.data.dataset import Dataset, View
from chona_model.data.images import Pixels, load_pixels
from chona_model.data.soundness import check_dataset, check_pixels, check_seen
from chona_model.grid_model import PosedFigure
from chona_model.render.posed import PosedPart, depth_spans


@dataclass(frozen=True)
class PoseViews:
    """All views of one pose."""

    views: tuple[View, ...]
    pixels: tuple[Pixels, ...]


@dataclass(frozen=True)
class ViewPool:
    """Reachable pixels of one view, K of them.

    Attributes:
        columns, rows: [K] int16; near, far: [K] float32 depths; rgb: [K, 3] uint8.
        part: [K] int8: 0 background, 1 person, 2 object.
        ray_share: the view's.
    """

    camera: Camera
    columns: np.ndarray
    rows: np.ndarray
    near: np.ndarray
    far: np.ndarray
    rgb: np.ndarray
    part: np.ndarray
    ray_share: float = 1.0


def group_by_pose(dataset: Dataset, scale: float) -> list[PoseViews]:
    """Loads every view and groups views of the same moment.

    Raises:
        DatasetError: an image is damaged, a number of the capture is not finite, or an identity is never seen.
    """
    check_dataset(dataset)
    groups: dict[tuple[str, str], list[View]] = {}
    for view in dataset.views:
        groups.setdefault((view.sequence, view.frame), []).append(view)
    result = []
    for views in groups.values():
        pixels = tuple(load_pixels(view, scale) for view in views)
        scaled = views if scale == 1.0 else [replace(view, camera=view.camera.scaled(scale)) for view in views]
        for view, image in zip(scaled, pixels, strict=True):
            check_pixels(view, image)
        result.append(PoseViews(tuple(scaled), pixels))
    everything = [(view, image) for group in result for view, image in zip(group.views, group.pixels, strict=True)]
    check_seen(dataset, [view for view, _ in everything], [image for _, image in everything], scale)
    return result


def make_pools(
    parts: Sequence[PosedPart], posed: Sequence[PosedFigure], groups: Sequence[PoseViews]
) -> list[list[ViewPool]]:
    """Pools of every pose's views; views that the hull does not reach are left out."""
    pools = []
    for index, group in enumerate(groups):
        row = []
        for view, pixels in zip(group.views, group.pixels, strict=True):
            near, far = depth_spans(parts[index], posed[index].figure, view.camera)
            rows, columns = np.nonzero(far > near)
            if len(rows) == 0:
                continue
            part = pixels.person[rows, columns] + 2 * pixels.object[rows, columns].astype(np.int8)
            row.append(
                ViewPool(
                    view.camera, columns.astype(np.int16), rows.astype(np.int16), near[rows, columns],
                    far[rows, columns],
                    np.round(pixels.rgb[rows, columns] * 255).astype(np.uint8), part.astype(np.int8),
                    view.ray_share,
                )
            )  # fmt: skip
        pools.append(row)
    return pools
