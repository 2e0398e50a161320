"""What farm managers are given: written to where they look for it."""

from __future__ import annotations

from pathlib import Path

from chona_model.formats.atomic import write_bytes

FILES = {"flamenco": "chona_bake.js", "slurm": "chona_bake.sbatch"}
"""Manager -> file of this package."""


def write_file(manager: str, folder: Path) -> Path:
    """Writes a manager's file into a folder, over an older one; its path.

    Raises:
        OSError: the folder cannot be written to.
    """
    target = folder / FILES[manager]
    write_bytes(target, Path(__file__).with_name(FILES[manager]).read_bytes())
    return target
