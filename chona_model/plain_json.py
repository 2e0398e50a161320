"""JSON from outside: of whatever a file holds, nothing but a ``JsonError`` comes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeVar

import msgspec

MOST_BYTES = 64 << 20
"""Of a file: more is no description of anything here, and a hundred times as much memory would be asked for."""

LONGEST_MESSAGE = 300
"""Characters that are told of an error: some repeat the file."""

Content = TypeVar("Content")


class JsonError(ValueError):
    """Text that is not JSON, or JSON of another form; the message says what and where."""


def parse(text: str | bytes) -> Any:
    """Any JSON, NaN and Infinity as Python writes them included.

    Raises:
        JsonError: it is none, is nested too deeply, or has text that is not Unicode and could not be printed.
    """
    try:
        content = json.loads(text)
        json.dumps(content, ensure_ascii=False).encode()  # half a surrogate pair passes the parser
    except (ValueError, RecursionError) as error:
        raise JsonError(shortened(error)) from error
    return content


def decode(text: str | bytes | bytearray, kind: type[Content]) -> Content:
    """JSON of a known form.

    Raises:
        JsonError: it is none, or has another form; the message names the field.
    """
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise JsonError(shortened(error)) from error


def convert(content: Any, kind: type[Content]) -> Content:
    """Parsed JSON as a known form; ``JsonError`` where it has another."""
    try:
        return msgspec.convert(content, kind)
    except (msgspec.ValidationError, RecursionError, OverflowError) as error:
        raise JsonError(shortened(error)) from error


def read_text(path: Path, most: int = MOST_BYTES) -> bytes:
    """The bytes of a file that has at most so many.

    Raises:
        JsonError: it has more.  OSError: it cannot be read.
    """
    with path.open("rb") as file:
        text = file.read(most + 1)
    if len(text) > most:
        raise JsonError(f"it has more than {most} bytes")
    return text


def shortened(error: object) -> str:
    """An error's words in one line of bearable length."""
    words = " ".join(str(error).split()) or type(error).__name__
    return words if len(words) <= LONGEST_MESSAGE else words[: LONGEST_MESSAGE - 1] + "…"
