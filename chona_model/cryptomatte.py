"""Cryptomatte: mattes of many things by name, as ranked pairs of id and coverage (Friedman and Jones 2015).

By Psyop's specification 1.2. An id is the MurmurHash3_32 of a name, read as a float; a *level* is one RGBA image of two
ranks (id, coverage, id, coverage), ranks sorted by falling coverage. Blender, Nuke and others pick mattes from it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

MOST_NAMES = 1024
"""Of a manifest that is read: every one is an image."""

FEW, LEVELS, MOST_LEVELS = 4, 2, 3
"""Levels of up to ``FEW`` names, whose ranks then hold them all, and of more."""

_WORD = 0xFFFFFFFF


@dataclass(frozen=True)
class Mattes:
    """What share of every pixel is whose.

    Attributes:
        names: of K things, each once.
        coverage: [H, W, K] float32, 0…1; over one pixel they sum to its alpha at most.
    """

    names: tuple[str, ...]
    coverage: np.ndarray


def collect(names: Sequence[str], coverage: np.ndarray) -> Mattes:
    """Mattes of things [H, W, K] of which several may go by one name: these are one."""
    unique = tuple(dict.fromkeys(names))
    if len(unique) == len(names):
        return Mattes(unique, coverage)
    of_name = np.array([[name == other for other in unique] for name in names], dtype=coverage.dtype)
    return Mattes(unique, coverage @ of_name)


def murmur3(text: str, seed: int = 0) -> int:
    """MurmurHash3_x86_32 of a text's UTF-8 bytes (Appleby 2011)."""
    data = text.encode("utf-8")
    whole = len(data) // 4 * 4
    value = seed
    for (word,) in struct.iter_unpack("<I", data[:whole]):
        value = _rotated(value ^ _mixed(word), 13) * 5 + 0xE6546B64 & _WORD
    value ^= _mixed(int.from_bytes(data[whole:], "little")) ^ len(data)
    value = (value ^ value >> 16) * 0x85EBCA6B & _WORD
    value = (value ^ value >> 13) * 0xC2B2AE35 & _WORD
    return value ^ value >> 16


def _mixed(word: int) -> int:
    return _rotated(word * 0xCC9E2D51 & _WORD, 15) * 0x1B873593 & _WORD


def _rotated(word: int, bits: int) -> int:
    return (word << bits | word >> 32 - bits) & _WORD


def matte_id(name: str) -> np.float32:
    """A name's id: its hash's bits as a float, one bit of the exponent turned where they would be no normal number."""
    value = murmur3(name)
    if value >> 23 & 0xFF in {0, 0xFF}:
        value ^= 1 << 23
    return np.frombuffer(struct.pack("<I", value), "<f4")[0]


def attributes(layer: str, names: Sequence[str]) -> dict[str, str]:
    """Header attributes of a Cryptomatte whose channels are called ``layer`` and the level's two digits."""
    prefix = f"cryptomatte/{murmur3(layer):08x}"[: len("cryptomatte/") + 7]
    manifest = {name: f"{_bits(matte_id(name)):08x}" for name in names}
    return {
        f"{prefix}/name": layer,
        f"{prefix}/hash": "MurmurHash3_32",
        f"{prefix}/conversion": "uint32_to_float32",
        f"{prefix}/manifest": json.dumps(manifest, ensure_ascii=False, separators=(",", ":")),
    }


def _bits(number: np.float32) -> int:
    (value,) = struct.unpack("<I", struct.pack("<f", number))
    return int(value)


def names_of(layer: str, header: Mapping[str, str]) -> tuple[str, ...] | None:
    """The names in a layer's manifest; None where a header has no such layer.

    Raises:
        ValueError: the manifest is no JSON object.
    """
    for key, value in header.items():
        parts = key.split("/")
        if len(parts) == 3 and (parts[0], parts[2], value) == ("cryptomatte", "name", layer):
            try:
                manifest = json.loads(header.get(f"cryptomatte/{parts[1]}/manifest", "null"))
            except (TypeError, RecursionError) as error:
                raise ValueError(f"the manifest of {layer} is no JSON ({type(error).__name__})") from error
            if not isinstance(manifest, dict) or len(manifest) > MOST_NAMES:
                raise ValueError(f"the manifest of {layer} is no JSON object of at most {MOST_NAMES} names")
            return tuple(manifest)
    return None


def level_count(names: Sequence[str]) -> int:
    """How many levels mattes of these names have."""
    return LEVELS if len(names) <= FEW else MOST_LEVELS


def rank(mattes: Mattes) -> list[np.ndarray]:
    """Levels [H, W, 4] float32, the greatest coverage first; what covers nothing has the id 0.

    Of more than two names a level, a pixel keeps those that cover most.
    """
    height, width = mattes.coverage.shape[:2]
    levels, ranks = level_count(mattes.names), 2 * level_count(mattes.names)
    ids = np.array([*(matte_id(name) for name in mattes.names), *[0.0] * ranks], dtype=np.float32)
    rows, columns = np.nonzero(mattes.coverage.any(axis=-1))
    covered = np.pad(mattes.coverage[rows, columns], ((0, 0), (0, ranks))).astype(np.float32)
    order = np.argsort(-covered, axis=-1, kind="stable")[:, :ranks]
    share = np.take_along_axis(covered, order, axis=-1)
    pairs = np.zeros((height, width, ranks, 2), dtype=np.float32)
    pairs[rows, columns, :, 0], pairs[rows, columns, :, 1] = np.where(share > 0, ids[order], 0.0), share
    return [pairs[:, :, 2 * level : 2 * level + 2].reshape(height, width, 4) for level in range(levels)]


def unrank(levels: Sequence[np.ndarray], names: Sequence[str]) -> Mattes:
    """The mattes of some names back out of levels [H, W, 4]; as ``rank`` was given them, where it kept all."""
    coverage = np.zeros((*levels[0].shape[:2], len(names)), dtype=np.float32)
    for place, name in enumerate(names):
        own = matte_id(name)
        for level in levels:
            for first in (0, 2):
                coverage[..., place] += np.where(level[..., first] == own, level[..., first + 1], np.float32(0.0))
    return Mattes(tuple(names), coverage)
