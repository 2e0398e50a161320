"""Tensors written to safetensors, whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor

from chona_model.formats.atomic import atomic_path

_OS_ERROR = re.compile(r"\(os error (\d+)\)")


def write_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Writes a safetensors file.

    Raises:
        WriteError: the disk is full, or the folder cannot be written to.
    """
    with atomic_path(path) as temporary, _folder(temporary.with_suffix("")) as folder:
        # The library has a temporary name of its own, which says nothing of its process, and lets nobody else read.
        inside = folder / path.name
        try:
            save_file(dict(tensors), inside, metadata=dict(metadata))
        except SafetensorError as error:
            told = _OS_ERROR.search(str(error))
            number = int(told[1]) if told else errno.EIO
            raise OSError(number, os.strerror(number)) from error
        inside.chmod(folder.stat().st_mode & 0o666)
        inside.replace(temporary)


@contextmanager
def _folder(path: Path) -> Iterator[Path]:
    path.mkdir()
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)
