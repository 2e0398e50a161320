"""What workers say: lines of JSON (docs/file-formats.md), taken for no more than what is checked here.

A worker's Python may be any program, and a crash may stop it in the middle of a word. So a line has a longest length, a
number is finite, a text can be shown, and what a field holds is said in one table. A line that is no such event is a
line of the log. Depends on nothing of Blender.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from typing import IO, Any

from .errors import ChonaError

LONGEST_LINE = 1 << 22
"""Bytes: of a longer line the rest is skipped."""
LONGEST_TEXT = 4096
"""Characters of one text, as many as a path may have; the rest is cut off."""
MOST_ITEMS = 10_000
"""Of a list or a mapping."""
LARGEST = 1e15
"""Size of any number: of bytes, of seconds, of steps."""

CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
Check = Callable[[Any], Any]


def number(value: object) -> int | float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not -LARGEST <= value <= LARGEST:
        raise ValueError("expected a finite number")
    return value


def amount(value: object) -> int | float:
    """A number that is not negative."""
    if number(value) < 0:
        raise ValueError("expected no negative number")
    return number(value)


def count(value: object) -> int:
    """A whole number that is not negative."""
    if not isinstance(value, int):
        raise ValueError("expected a whole number")
    return int(amount(value))


def flag(value: object) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise ValueError("expected true or false")
    return value


def text(value: object) -> str:
    """Text of one line that Blender can show."""
    if not isinstance(value, str):
        raise ValueError("expected text")
    return clean(value)


def clean(words: str) -> str:
    """Words on one line, without what cannot be shown: control characters, halves of surrogate pairs."""
    return CONTROL.sub(" ", words[:LONGEST_TEXT].encode("utf-8", "replace").decode())


def optional(check: Check) -> Check:
    """Nothing, or what `check` lets pass."""
    return lambda value: None if value is None else check(value)


def listed(check: Check, exactly: int | None = None) -> Check:
    """A list of what `check` lets pass."""

    def checked(value: object) -> list[Any]:
        if not isinstance(value, list) or len(value) > MOST_ITEMS or exactly not in {None, len(value)}:
            raise ValueError("expected a list")
        return [check(item) for item in value]

    return checked


def mapped(check: Check) -> Check:
    """A mapping of names to what `check` lets pass."""

    def checked(value: object) -> dict[str, Any]:
        if not isinstance(value, dict) or len(value) > MOST_ITEMS:
            raise ValueError("expected a mapping")
        return {text(name): check(item) for name, item in value.items()}

    return checked


def record(needed: Mapping[str, Check]) -> Check:
    """A mapping that has at least these fields."""

    def checked(value: object) -> dict[str, Any]:
        if not isinstance(value, dict) or not needed.keys() <= value.keys():
            raise ValueError("expected a mapping with more fields")
        return fields(value, needed)

    return checked


def fields(content: Mapping[str, Any], known: Mapping[str, Check]) -> dict[str, Any]:
    """The fields that are known and right, and of others those that hold a single value.

    Raises:
        ValueError: one that is known holds something else.
    """
    kept = {name: known[name](value) for name, value in content.items() if name in known}
    for name, value in content.items():
        if name not in known and name.isidentifier() and len(name) < 64:
            for check in (flag, number, text):
                try:
                    kept[name] = check(value)
                    break
                except ValueError:
                    continue
    return kept


PACKAGES = {
    "python": listed(count, exactly=3), "missing": listed(text), "broken": mapped(text), "versions": mapped(text),
    "notes": listed(listed(text, exactly=3)),
}  # fmt: skip
"""What a worker's Python says of itself, at least."""

SEQUENCE = {
    "name": text, "views": count, "checked": count, "joints_inside": optional(amount),
    "objects_inside": optional(amount), "sheet": optional(text),
}  # fmt: skip

FIELDS: dict[str, Check] = {
    "job": text, "message": text, "seconds": amount,
    # how far a job is
    "done": number, "total": optional(number), "eta": optional(amount), "loss": optional(number),
    "psnr": optional(number),
    # what it has made: frames, captures, measurements
    "written": count, "skipped": count, "words": text, "warnings": listed(text), "plot": text,
    "max_error": optional(record({"asked": amount, "error": amount, "unsettled": count, "pixels": count})),
    "frames": count, "presets": mapped(record({"seconds_per_frame": amount, "total_seconds": amount})),
    "headline": text, "sound": flag, "sequences": listed(record(SEQUENCE)),
    # a Python and an environment
    **PACKAGES, "executable": text, "torch": text, "torch_cuda": optional(text), "cuda": text, "chona_model": text,
    "base": record({"path": text, "version": listed(count, exactly=3), "lacks": listed(text)}),
    "environment": text, "check": record(PACKAGES), "bytes": count,
    # live pictures
    "request": count, "preset": text, "width": count, "height": count,
}  # fmt: skip
"""What a field holds, in whatever event it is."""

EVENTS: dict[str, tuple[str, ...]] = {
    "start": (), "progress": (), "result": (), "error": (), "cancelled": (), "ready": (), "skipped": ("request",),
    "frame": ("request", "preset", "width", "height", "seconds", "bytes"),
}  # fmt: skip
"""The kinds of events, and what they cannot do without."""


def read_lines(stream: IO[bytes]) -> Iterator[str]:
    """A process's lines as a terminal would show them: of what it has overwritten with a carriage return, the last."""
    begins = True
    while part := stream.readline(LONGEST_LINE):
        if begins:
            yield part.decode("utf-8", "replace").rstrip("\r\n").rpartition("\r")[2]
        begins = part.endswith(b"\n")


def parse_event(line: str) -> dict[str, Any] | None:
    """A line of the progress protocol, or None when it is something else that was printed."""
    if not line.startswith("{"):
        return None
    try:
        return understood(json.loads(line))
    except (ValueError, RecursionError):
        return None


def understood(content: object) -> dict[str, Any] | None:
    """An event as it can be relied on, with `event`, its kind; None where it is none."""
    kind = content.get("event") if isinstance(content, dict) else None
    if not isinstance(content, dict) or not isinstance(kind, str) or kind not in EVENTS:
        return None
    try:
        kept = fields(content, FIELDS)
    except ValueError:
        return None
    return kept if kept.keys() >= set(EVENTS[kind]) else None


def need(result: Mapping[str, Any], *names: str) -> None:
    """Refuse a result that lacks something.

    Raises:
        ChonaError: a field is not there.
    """
    missing = [name for name in names if name not in result]
    if missing:
        raise ChonaError(
            f"what the worker says is not understood, it has no {missing[0]!r}; install the CHONA extension again, so "
            "that add-on and worker are of one version"
        )
