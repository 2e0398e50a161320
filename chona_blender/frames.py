"""Baked frames on disk and lists of frame numbers.

Frame N of a bake called NAME is the file `NAME_%04d.exr` (docs/file-formats.md).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from .errors import ChonaError

NUMBER = re.compile(r"_(-?\d{4,})\.exr$")


@dataclass(frozen=True)
class BakedFrames:
    """The frames of one bake in one folder. `numbers` are those that Blender can show: 0 and above, increasing."""

    folder: Path
    name: str
    numbers: tuple[int, ...]
    negative: tuple[int, ...]

    def path(self, number: int) -> Path:
        """The file of one frame."""
        return self.folder / frame_file_name(self.name, number)

    @property
    def missing(self) -> tuple[int, ...]:
        """Numbers without a file between the first and the last one."""
        present = set(self.numbers)
        return tuple(n for n in range(self.numbers[0], self.numbers[-1] + 1) if n not in present)


def frame_file_name(name: str, number: int) -> str:
    """`walk`, 7 -> `walk_0007.exr`; negative numbers keep their sign in front of four digits."""
    return f"{name}_-{-number:04d}.exr" if number < 0 else f"{name}_{number:04d}.exr"


def find_baked_frames(folder: Path, name: str) -> BakedFrames:
    """All frames of the bake `name` in `folder`; none is an error that says what is there instead."""
    if not folder.is_dir():
        raise ChonaError(f"there is no folder {folder}; bake first, or set the output folder to where the frames are")
    numbers, others = [], set()
    for path in folder.glob("*.exr"):
        match = NUMBER.search(path.name)
        if match is None:
            continue
        if path.name[: match.start()] == name:
            numbers.append(int(match.group(1)))
        else:
            others.add(path.name[: match.start()])
    if not numbers:
        there = f"; it holds bakes named {', '.join(sorted(others))}" if others else ""
        raise ChonaError(f"no frames {name}_0001.exr … in {folder}{there}; bake first, or correct the name")
    numbers.sort()
    return BakedFrames(folder, name, tuple(n for n in numbers if n >= 0), tuple(n for n in numbers if n < 0))


def parse_frames(text: str) -> list[int]:
    """`1-50,60` or `-5-3` or `1-50:2` -> increasing frame numbers without repeats."""
    numbers: set[int] = set()
    for raw in text.split(","):
        part = raw.strip()
        match = re.fullmatch(r"(-?\d+)(?:(?:-|\.\.)(-?\d+)(?::(\d+))?)?", part)
        if match is None:
            raise ChonaError(
                f"frames {text!r}: {part!r} is not a number or a range; write for example 1-50,60 or 1-50:2"
            )
        first = int(match.group(1))
        last = int(match.group(2)) if match.group(2) is not None else first
        step = int(match.group(3) or 1)
        if last < first or step < 1:
            raise ChonaError(f"frames {text!r}: the range {part!r} is empty; write the smaller number first")
        numbers.update(range(first, last + 1, step))
    return sorted(numbers)


def describe_frames(numbers: Iterable[int]) -> str:
    """Short words for a list of frames: `1-50` or `1-50, 48 of 50`."""
    frames = list(numbers)
    if not frames:
        return "no frames"
    if len(frames) == 1:
        return f"frame {frames[0]}"
    whole = frames[-1] - frames[0] + 1
    text = f"frames {frames[0]}–{frames[-1]}"
    return text if whole == len(frames) else f"{text} ({len(frames)} of {whole})"
