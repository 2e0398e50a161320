"""One thing that is wrong with an actor, as a list shows it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

ERROR, WARNING, INFO = "ERROR", "WARNING", "INFO"


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        kind: ``ERROR`` a bake refuses, ``WARNING`` seen in the picture, ``INFO`` to be known.
        actor: its label.
        item: name of the armature or object to select, '' for none.
        bone: of the armature, '' for none.
        model_bone: of the model, '' for none.
        frame: the worst one, None where it is wrong in all.
        words: what it is, for people.
        short: the same in two or three words, to stand behind the bone's name.
    """

    kind: str
    actor: str
    item: str
    bone: str
    model_bone: str
    frame: int | None
    words: str
    short: str = ""

    @property
    def title(self) -> str:
        """What it is about: the bone, else the object or the actor."""
        return self.bone or self.model_bone or self.item or self.actor or "Scene"


def frame_words(numbers: Iterable[int], most: int = 3) -> str:
    """Frames in words, runs together: ``frame 7``, ``frames 1–4, 9 and 12–20``, ``frames 1, 3, 5 and 8 more``."""
    frames = sorted(set(numbers))
    if not frames:
        return "no frame"
    runs: list[list[int]] = []
    for number in frames:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    shown = [f"{first}" if first == last else f"{first}–{last}" for first, last in runs[:most]]
    rest = sum(last - first + 1 for first, last in runs[most:])
    last_words = f"{rest} more" if rest else shown.pop() if len(shown) > 1 else ""
    words = ", ".join(shown) + (f" and {last_words}" if last_words else "")
    return f"frame {words}" if len(frames) == 1 else f"frames {words}"
