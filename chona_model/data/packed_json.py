"""Gzipped JSON of data sets, read up to a size that was agreed upon and checked against a type."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import TypeVar

from chona_model.data.dataset import DatasetError
from chona_model.plain_json import JsonError, decode

MAX_BYTES = 4 << 30
"""CO3D's largest category has 1.5 GB of frame annotations when unpacked."""
MOST_PACKED = 64
"""Bytes that one of the file's becomes (CO3D: 4 to 8), where there are more than ``_CHUNK``."""
_CHUNK = 1 << 22

Content = TypeVar("Content")


def read_packed(path: Path, kind: type[Content], what: str, max_bytes: int = MAX_BYTES) -> Content:
    """The contents of a ``.jgz`` file; fields that ``kind`` does not have are passed over.

    Args:
        what: the contents, in words for messages.

    Raises:
        DatasetError: the file is missing, damaged, of another form, or larger than ``max_bytes`` when unpacked.
    """
    content = bytearray()
    try:
        most = min(max_bytes, max(_CHUNK, MOST_PACKED * path.stat().st_size))
        with gzip.open(path, "rb") as file:
            while chunk := file.read(_CHUNK):
                content += chunk
                if len(content) > most:
                    raise DatasetError(f"{path} unpacks to more than {most} bytes; expected {what}")
        return decode(content, kind)
    except (OSError, EOFError, zlib.error) as error:
        raise DatasetError(f"cannot read {path}: {error}; expected {what} (gzipped JSON), copy it again") from error
    except JsonError as error:
        raise DatasetError(f"{path} holds something else than {what}: {error}") from error
