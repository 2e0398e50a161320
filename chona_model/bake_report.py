"""What a bake did, and what it did not have to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from chona_model.adaptive import Reached
from chona_model.passes import Passes
from chona_model.sight import Unseen

REPLACED = "the model file was replaced meanwhile: all frames are of the model before, bake again for the new one"
NAMED = 4
"""So many names are said in a sentence; of more, the number."""


@dataclass(frozen=True)
class LeftOut:
    """Work that a shot did not require.

    Attributes:
        loaded: whether the model was loaded at all; not where every frame was there.
        identities: names of the model's persons and objects that were not loaded.
        bytes_not_read: of the model's tensors.
        rendered: frames that were rendered; what follows is of these.
        pictures_kept: actors' pictures taken from the frame before, as neither actor nor camera had moved.
        bones_at_rest: bones a frame folded into the identity, on average; bones: of so many, the root not counted.
        out_of_picture: in how many frames which person or object of an actor was in no pixel.
        passes: which were not asked for.
    """

    loaded: bool = False
    identities: tuple[str, ...] = ()
    bytes_not_read: int = 0
    rendered: int = 0
    pictures_kept: int = 0
    bones_at_rest: float = 0.0
    bones: float = 0.0
    out_of_picture: Mapping[Unseen, int] = field(default_factory=dict)
    passes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        unseen = [{"actor": who.actor, "name": who.name, "frames": n} for who, n in sorted(self.out_of_picture.items())]
        return {
            "model_loaded": self.loaded, "identities": list(self.identities), "bytes_not_read": self.bytes_not_read,
            "pictures_kept": self.pictures_kept, "bones_at_rest": round(self.bones_at_rest, 2),
            "bones": round(self.bones, 2), "out_of_picture": unseen, "passes": list(self.passes),
        }  # fmt: skip

    def sentence(self) -> str:
        """In words; empty where everything was needed."""
        words = []
        if not self.loaded:
            words.append("the model, as no frame had to be rendered")
        elif self.identities:
            words.append(f"{_some(self.identities)} ({self.bytes_not_read / 1e6:.1f} MB of the model)")
        if self.pictures_kept:
            words.append(f"{self.pictures_kept} pictures of actors that stood still")
        if self.bones_at_rest:
            words.append(f"{self.bones_at_rest:.3g} of {self.bones:.3g} bones a frame, at rest")
        for who, count in sorted(self.out_of_picture.items()):
            name = who.name if who.name == who.actor else f"{who.name} of {who.actor}"
            words.append(f"{name} in {count} of {self.rendered} frames, out of the picture")
        if self.passes:
            words.append(f"the passes {_some(self.passes)}")
        return f"Left out: {'; '.join(words)}." if words else ""


@dataclass(frozen=True)
class BakeReport:
    """What a bake did.

    Attributes:
        written, skipped: frames written, and left alone because they were up to date.
        repeated: those of the written that were copied from a frame that shows the same.
        seconds: in all.
        left_out: what else was spared.
        reached: what a bound on the error came to, or None without one.
        model_replaced: whether the file of a model is another one by now; every frame is of the one before.
    """

    written: int
    skipped: int
    repeated: int
    seconds: float
    left_out: LeftOut = LeftOut()
    reached: Reached | None = None
    model_replaced: bool = False

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "written": self.written, "skipped": self.skipped, "repeated": self.repeated,
            "seconds": round(self.seconds, 3), "left_out": self.left_out.as_dict(),
            **({"max_error": self.reached.as_dict()} if self.reached else {}),
            **({"model_replaced": True} if self.model_replaced else {}),
        }  # fmt: skip

    def sentence(self) -> str:
        """In words, for a terminal."""
        copied = f" ({self.repeated} copied)" if self.repeated else ""
        reached = f"; {self.reached.sentence()}" if self.reached else ""
        replaced = f"; {REPLACED}" if self.model_replaced else ""
        return (
            f"{self.written} frames written{copied}, {self.skipped} were up to date, {self.seconds:.1f} s{reached}"
            f"{replaced}"
        )


class Tally:
    """Counts over the frames of a bake."""

    def __init__(self, passes: Passes) -> None:
        self._passes = passes
        self._frames = self._still = self._bones = 0
        self._unseen: dict[Unseen, int] = {}

    def rendered(self, unseen: list[Unseen], bones: tuple[int, int]) -> None:
        """One more frame was rendered.

        Args:
            unseen: who was out of its picture; bones: how many were folded, and of how many.
        """
        self._frames += 1
        self._still += bones[0]
        self._bones += bones[1]
        for who in unseen:
            self._unseen[who] = self._unseen.get(who, 0) + 1

    def left_out(self, loaded: bool, identities: tuple[str, ...], bytes_not_read: int, kept: int) -> LeftOut:
        """What was counted, and what is known of the loading."""
        frames = max(self._frames, 1)
        return LeftOut(
            loaded, identities, bytes_not_read, self._frames, kept, self._still / frames, self._bones / frames,
            dict(self._unseen), self._passes.left_out,
        )  # fmt: skip


def _some(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{more}"
