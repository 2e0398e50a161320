"""How much memory frames take beside the model, and how they are cut so that they take no more than allowed."""

from __future__ import annotations

from chona_model.formats.shot import Shot
from chona_model.grid_actor import TILE
from chona_model.memory import GIGABYTE, resident
from chona_model.passes import Passes
from chona_model.settings import SettingsError

PICTURE_BYTES, ACTOR_BYTES, NORMAL_BYTES, PART_BYTES, BLUR_BYTES = 160, 40, 60, 24, 160
"""Of a pixel: a picture on its way to its file, another actor's, its normals, each part of a Cryptomatte, moments."""
TILE_BYTES = 400
"""Of a pixel that is looked at, with its rays."""
LEAST_TILE = 1 << 12
"""Pixels looked at together at least: fewer would take several times as long."""


def tile_within(gigabytes: float, shot: Shot, passes: Passes, blurred: bool) -> int:
    """Pixels to be looked at together, so that this process keeps to so many GB (2^30 bytes) with what it has loaded.

    Raises:
        SettingsError: the pictures themselves take more.
    """
    loaded, parts = resident() or 0, sum((actor.person is not None) + len(actor.objects) for actor in shot.actors)
    pixel = PICTURE_BYTES + ACTOR_BYTES * (len(shot.actors) - 1) + NORMAL_BYTES * passes.normal
    pixel += PART_BYTES * parts * passes.cryptomatte + BLUR_BYTES * blurred
    pictures = shot.width * shot.height * pixel
    left = gigabytes * GIGABYTE - loaded - pictures
    if left < LEAST_TILE * TILE_BYTES:
        least = (loaded + pictures + LEAST_TILE * TILE_BYTES) / GIGABYTE
        raise SettingsError(
            f"--max-memory is {gigabytes:g} GB, and this bake takes {least + 0.05:.1f} at least: "
            f"{loaded / GIGABYTE:.1f} for the program and the model, {pictures / GIGABYTE:.1f} for pictures of "
            f"{shot.width}x{shot.height}; allow as much, or bake a smaller picture or fewer passes"
        )
    return int(min(left / TILE_BYTES, TILE))
