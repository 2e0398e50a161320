"""What the command line's values mean: frame lists, numbers in a range, capture sources, folders to write to.

Light on purpose: nothing here may slow the start of ``chona --help``.
"""

from __future__ import annotations

import argparse
import math
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

MAX_FRAMES = 1_000_000
_RANGE = re.compile(r"(-?\d+)(?:-(-?\d+))?")


class UsageError(ValueError):
    """Arguments that cannot be used: what was given, what was expected, what to do, in one line."""


class Parser(argparse.ArgumentParser):
    """Raises instead of printing its usage over several lines and exiting; options are never abbreviated."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **{"allow_abbrev": False} | options)

    def error(self, message: str) -> NoReturn:
        """One line for the reporter."""
        raise UsageError(f"{message}; see '{self.prog} --help'")


@dataclass(frozen=True)
class Source:
    """One ``--data`` with what belongs to it; None where nothing was given."""

    data: Path
    format: str = "auto"
    sequences: tuple[str, ...] | None = None
    split: str | None = None
    cameras: tuple[str, ...] | None = None
    object_size: float | None = None


class SourceAction(argparse.Action):
    """Collects ``--data`` and the options that belong to one of several, in the order in which they were given."""

    def __call__(
        self,
        _parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        value: Any,
        _option: str | None = None,
    ) -> None:
        namespace.sources = [*(getattr(namespace, "sources", None) or []), (self.dest, value)]


def sources_of(given: Sequence[tuple[str, Any]] | None) -> tuple[Source, ...]:
    """Every ``--data`` with the options between it and the next one; options before the first belong to the first.

    Raises:
        UsageError: no ``--data``, or an option twice for one of them.
    """
    groups: list[dict[str, Any]] = [{}]
    for name, value in given or ():
        if name == "data" and "data" in groups[-1]:
            groups.append({})
        if name in groups[-1]:
            raise UsageError(
                f"--{name} is given twice for --data {groups[-1].get('data', '')}; expected once, written after the "
                "--data that it belongs to"
            )
        groups[-1][name] = value
    for group in groups:
        if "data" not in group:
            raise UsageError("no --data is given; expected --data DIR, a folder with a capture")
        if group.get("sequences") is not None and group.get("split") is not None:
            raise UsageError(
                f"both --sequences and --split are given for --data {group['data']}; name the views by one of the two"
            )
    return tuple(Source(**group) for group in groups)


def job_file(text: str) -> Path:
    """``FILE.json``; what else belongs to the job has the same name with another ending.

    Raises:
        argparse.ArgumentTypeError: another ending.
    """
    path = Path(text)
    if path.suffix != ".json":
        raise argparse.ArgumentTypeError(f"{text} does not end in .json")
    return path.absolute()


def frame_list(text: str) -> tuple[int, ...]:
    """``1-50,60`` as frame numbers, increasing, each once; ``-5--1`` are the five frames before 0.

    Raises:
        argparse.ArgumentTypeError: not a list of frames, or an empty one.
    """
    frames: set[int] = set()
    for part in text.split(","):
        match = _RANGE.fullmatch(part.strip())
        if match is None:
            raise argparse.ArgumentTypeError(
                f"got '{text}', expected frames and ranges such as 1-50,60 or -5--1; correct the part '{part.strip()}'"
            )
        first = int(match[1])
        last = first if match[2] is None else int(match[2])
        if last < first:
            raise argparse.ArgumentTypeError(
                f"the range '{part.strip()}' is empty because {last} is before {first}; write {last}-{first}"
            )
        if last - first + len(frames) >= MAX_FRAMES:
            raise argparse.ArgumentTypeError(f"'{text}' names more than {MAX_FRAMES} frames; expected fewer")
        frames.update(range(first, last + 1))
    return tuple(sorted(frames))


def name_list(text: str) -> tuple[str, ...]:
    """``A,B`` as names."""
    names = tuple(name for part in text.split(",") if (name := part.strip()))
    if not names:
        raise argparse.ArgumentTypeError(
            "the list is empty; expected names such as A,B, or leave the option out for all"
        )
    return names


def number(lowest: float, highest: float = math.inf, *, above: bool = False) -> Callable[[str], float]:
    """A type of finite numbers from ``lowest`` (or ``above`` it) to ``highest``."""
    expected = f"a number {'above' if above else 'of at least'} {lowest:g}"
    expected += "" if math.isinf(highest) else f" and at most {highest:g}"

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and lowest <= value <= highest) or (above and value == lowest):
            raise argparse.ArgumentTypeError(f"got '{text}', expected {expected}")
        return value

    return parse


def whole(lowest: int, highest: int) -> Callable[[str], int]:
    """A type of whole numbers from ``lowest`` to ``highest``."""

    def parse(text: str) -> int:
        value = int(text) if re.fullmatch(r"[+-]?\d{1,19}", text) else None
        if value is None or not lowest <= value <= highest:
            raise argparse.ArgumentTypeError(f"got '{text}', expected a whole number from {lowest} to {highest}")
        return value

    return parse


def glue_frames(arguments: Sequence[str]) -> list[str]:
    """Joins ``--frames -5--1`` to ``--frames=-5--1``: argparse would take the value for an option."""
    glued: list[str] = []
    for argument in arguments:
        if glued and glued[-1] == "--frames" and re.match(r"-\d", argument):
            glued[-1] = f"--frames={argument}"
        else:
            glued.append(argument)
    return glued


def writable_folder(path: Path, option: str) -> Path:
    """Makes a folder and tries whether it takes files, before minutes of work go into it.

    Raises:
        UsageError: a file is in the way, or the folder cannot be written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):  # without a name: nothing is left of it, whatever happens
            pass
    except FileExistsError:
        raise UsageError(f"{option} is {path}, which is a file; expected a folder: name another one") from None
    except NotADirectoryError:
        raise UsageError(f"{option} is {path}, which lies below a file; expected a folder: name another one") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(
            f"{option} is {path}, which cannot be written to ({reason}); name another folder, or correct its rights"
        ) from error
    return path


def writable_file(path: Path, option: str) -> Path:
    """Tries whether a file can be written; what is there stays.

    Raises:
        UsageError: a folder is in the way, or its folder cannot be written to.
    """
    if path.is_dir():
        raise UsageError(f"{option} is {path}, which is a folder; expected a file: add a name")
    writable_folder(path.parent, f"the folder of {option}")
    return path
