"""Paths that a data set names: inside of its own folder, or refused."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from chona_model.data.dataset import DatasetError

LONGEST_NAME = 150
"""Bytes of a name that files are called after; with what is added, file systems take 255."""


def named_file(folder: Path, name: str, source: Path | str) -> Path | None:
    """The file that ``source`` names relative to ``folder``; None where it is not there.

    Raises:
        DatasetError: the name is absolute, climbs, follows a link out of the folder, or can be no file's.
    """
    text = name.replace("\\", "/")
    path = folder / text
    refused = f"{source} names a file outside of its folder: {name[:LONGEST_NAME]!r}; refused"
    if Path(text).is_absolute() or ".." in Path(text).parts or text[1:2] == ":":
        raise DatasetError(f"{refused}, expected a path inside of {folder}")
    try:
        if not path.is_file():
            return None
        inside = _real(str(path.parent)).is_relative_to(_real(str(folder)))
        inside = inside and (not path.is_symlink() or path.resolve().is_relative_to(_real(str(folder))))
    except (OSError, ValueError) as error:  # too long, or with a zero byte
        raise DatasetError(
            f"{source} names a file that cannot be one: {name[:LONGEST_NAME]!r} ({type(error).__name__}); correct it"
        ) from error
    if not inside:
        raise DatasetError(f"{refused}, as a link leads there: copy the files into {folder}")
    return path


def check_name(name: str, source: Path | str) -> str:
    """``name`` as it is; ``DatasetError`` where no file could be called after it, or one elsewhere would be."""
    if not name or name.startswith(".") or set(name) & set("/\\\0") or len(name.encode()) > LONGEST_NAME:
        raise DatasetError(
            f"{source} has the name {name[:LONGEST_NAME]!r}, expected one that files can be called after: without / "
            f"and \\, no dot first, at most {LONGEST_NAME} bytes; rename it"
        )
    return name


@lru_cache(maxsize=256)
def _real(folder: str) -> Path:
    return Path(folder).resolve()
