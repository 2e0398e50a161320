"""Baked frames: single-part EXR with colour and what passes were asked for, as ``docs/file-formats.md`` describes them.

Single-part, with a pass and a channel letter in every name: what every Blender from 4.2 on reads alike.
"""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from chona_model import cryptomatte
from chona_model.cryptomatte import Mattes
from chona_model.formats.atomic import atomic_path
from chona_model.formats.exr_structure import ExrError, check_exr
from chona_model.passes import DEFAULT_PASSES, Passes

LAYER = "CHONA"
EMPTY_DEPTH = 1e10
"""Depth of a pixel that nothing covers, as Blender writes it."""
HALF_MAX = 65504.0
PROBE_BYTES = 1 << 20
"""Written to a folder that did not take a frame, to learn why."""
CRYPTO_LAYER = f"{LAYER}.CryptoActor"
"""The Cryptomatte, as its channels and the header call it."""
_MATTES = {"human": "Human", "object": "Object", "confidence": "Confidence"}
_PASSES_ATTRIBUTE = "chona:passes"

__all__ = ["EMPTY_DEPTH", "LAYER", "ExrError", "FrameHeader", "FrameLayers", "frame_name", "is_finished", "read_frame",
           "write_frame"]  # fmt: skip


@dataclass(frozen=True)
class FrameLayers:
    """The pixels of one frame; None for a pass that was not asked for.

    Attributes:
        combined: [H, W, 4] scene-linear Rec.709, premultiplied.
        depth: [H, W] metres along the camera axis, ``EMPTY_DEPTH`` where empty.
        human, object: [H, W] share of the pixel's alpha that is the person or an object; both or none.
        confidence: [H, W] share of samples whose inverse skinning converged.
        normal: [H, W, 3] in the world, of length one; 0 where empty.
        cryptomatte: share of the pixel that is each person or object of each actor.
    """

    combined: np.ndarray
    depth: np.ndarray | None = None
    human: np.ndarray | None = None
    object: np.ndarray | None = None
    confidence: np.ndarray | None = None
    normal: np.ndarray | None = None
    cryptomatte: Mattes | None = None

    @property
    def passes(self) -> Passes:
        """Which there are."""
        given = (self.depth, self.human, self.confidence, self.normal, self.cryptomatte)
        return Passes(*(array is not None for array in given))


@dataclass(frozen=True)
class FrameHeader:
    """Where a frame came from.

    Attributes:
        model: SHA-256 of the model file.
        shot: SHA-256 of the frame's pose, camera and settings.
        preset: name.
        settings: JSON.
        seconds: render time.
        frame: scene frame number.
    """

    model: str
    shot: str
    preset: str
    settings: str
    seconds: float
    frame: int


def frame_name(shot_name: str, frame: int) -> str:
    """``walk_0001.exr``; negative frames keep their sign: ``walk_-0001.exr``."""
    sign = "-" if frame < 0 else ""
    return f"{shot_name}_{sign}{abs(frame):04d}.exr"


def write_frame(
    path: Path, layers: FrameLayers, header: FrameHeader, confirm: Callable[[], None] | None = None
) -> None:
    """Writes one frame whole or not at all, over what was there; passes that are None are not in the file.

    Colours beyond half precision's range are limited to it.

    Args:
        confirm: called right before the frame is put into its place; where it raises, what was there stays.

    Raises:
        ExrError: shapes differ or a value is not finite.
        WriteError: the disk is full or the folder cannot be written to.
    """
    _check_layers(layers)
    # OpenEXR writes zeros, without a word, of arrays that are not contiguous.
    combined = np.clip(layers.combined, -HALF_MAX, HALF_MAX)
    channels = {f"{LAYER}.Combined": np.ascontiguousarray(combined, dtype=np.float16)}
    if layers.depth is not None:
        channels[f"{LAYER}.Depth.Z"] = np.ascontiguousarray(layers.depth, dtype=np.float32)
    for field, name in _MATTES.items():
        pixels = getattr(layers, field)
        if pixels is not None:
            channels[f"{LAYER}.{name}.V"] = np.ascontiguousarray(pixels, dtype=np.float16)
    if layers.normal is not None:
        for axis, letter in enumerate("XYZ"):
            channels[f"{LAYER}.Normal.{letter}"] = np.ascontiguousarray(layers.normal[..., axis], dtype=np.float16)
    named: dict[str, str] = {}
    if layers.cryptomatte is not None:
        named = cryptomatte.attributes(CRYPTO_LAYER, layers.cryptomatte.names)
        for level, pixels in enumerate(cryptomatte.rank(layers.cryptomatte)):
            channels[f"{CRYPTO_LAYER}{level:02d}"] = np.ascontiguousarray(pixels, dtype=np.float32)
    attributes = {
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "chona:model": header.model,
        "chona:shot": header.shot,
        "chona:preset": header.preset,
        "chona:settings": header.settings,
        "chona:seconds": float(header.seconds),
        "chona:frame": int(header.frame),
        _PASSES_ATTRIBUTE: _passes_text(layers.passes),
        **named,
    }
    with atomic_path(path, confirm) as temporary:
        try:
            OpenEXR.File(attributes, channels).write(str(temporary))
        except (RuntimeError, ValueError) as error:
            raise _cause(path.parent, error) from error
        try:
            check_exr(temporary)  # a full disk must not leave a frame that counts as finished
        except ExrError as error:
            raise _cause(path.parent, error) from error


def _cause(folder: Path, error: Exception) -> OSError:
    """Why a frame was not written: OpenEXR does not say."""
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(bytes(PROBE_BYTES))
            probe.flush()
    except OSError as reason:
        return reason
    return OSError(errno.EIO, str(error))


def read_frame(path: Path) -> tuple[FrameLayers, FrameHeader]:
    """Reads a frame that ``write_frame`` wrote; arrays are float32, None for passes that it does not have.

    Raises:
        ExrError: the file is missing, damaged, or lacks channels or attributes of this program.
    """
    check_exr(path)
    try:
        with OpenEXR.File(str(path)) as file:
            attributes = dict(file.header())  # its own is emptied when the file closes
            pixels = {name: channel.pixels.astype(np.float32) for name, channel in file.channels().items()}
        human, thing, confidence = (pixels.get(f"{LAYER}.{name}.V") for name in _MATTES.values())
        layers = FrameLayers(
            pixels[f"{LAYER}.Combined"], pixels.get(f"{LAYER}.Depth.Z"), human, thing, confidence,
            _read_normal(pixels), _read_cryptomatte(pixels, attributes),
        )  # fmt: skip
        _check_layers(layers)
        told = attributes.get(_PASSES_ATTRIBUTE, _passes_text(DEFAULT_PASSES))
        if _passes_text(layers.passes) != told or (layers.human is None) != (layers.object is None):
            raise ExrError(
                f"{path} has the passes {_passes_text(layers.passes)}, its header says {told}: render it again"
            )
        names = ("model", "shot", "preset", "settings", "seconds", "frame")
        return layers, FrameHeader(*(attributes[f"chona:{name}"] for name in names))
    except KeyError as error:
        raise ExrError(f"{path} lacks {error}; expected a frame baked by this program") from error
    except (RuntimeError, ValueError, TypeError) as error:
        raise ExrError(f"cannot read {path}: {error}; render it again") from error


def is_finished(
    path: Path, model_hash: str, shot_hash: str, passes: Passes = DEFAULT_PASSES, matte_names: Sequence[str] = ()
) -> bool:
    """Whether ``path`` is a whole frame of this model, pose, camera, settings and passes.

    Anything else is rendered again, as is a Cryptomatte of other names than ``matte_names``.
    """
    try:
        structure = check_exr(path)
    except ExrError:
        return False
    if passes.cryptomatte:
        wanted = cryptomatte.attributes(CRYPTO_LAYER, tuple(dict.fromkeys(matte_names)))
        if any(structure.text(name) != value for name, value in wanted.items()):
            return False
    whole = _passes_text(DEFAULT_PASSES)  # what frames have that are older than the attribute
    told = structure.text(_PASSES_ATTRIBUTE) or whole
    return (structure.text("chona:model"), structure.text("chona:shot"), told) == (
        model_hash, shot_hash, _passes_text(passes),
    )  # fmt: skip


def _read_normal(pixels: Mapping[str, np.ndarray]) -> np.ndarray | None:
    names = [f"{LAYER}.Normal.{letter}" for letter in "XYZ"]
    return np.stack([pixels[name] for name in names], axis=-1) if names[0] in pixels else None


def _read_cryptomatte(pixels: Mapping[str, np.ndarray], attributes: Mapping[str, Any]) -> Mattes | None:
    names = cryptomatte.names_of(CRYPTO_LAYER, attributes)
    if names is None:
        return None
    levels = [pixels[f"{CRYPTO_LAYER}{level:02d}"] for level in range(cryptomatte.level_count(names))]
    if any(level.shape != levels[0].shape or level.shape[2:] != (4,) for level in levels):
        raise ExrError(
            f"the Cryptomatte has levels of the shapes {[level.shape for level in levels]}, expected [H, W, 4]"
        )
    return cryptomatte.unrank(levels, names)


def _passes_text(passes: Passes) -> str:
    return ",".join(passes.names)


def _check_layers(layers: FrameLayers) -> None:
    size = layers.combined.shape[:2]
    if layers.combined.ndim != 3 or layers.combined.shape[2] != 4 or 0 in size:
        raise ExrError(f"combined has the shape {layers.combined.shape}, expected [H, W, 4]")
    if (layers.human is None) != (layers.object is None):
        raise ExrError("there is a matte of the person or of objects alone; expected both or none")
    arrays = {name: getattr(layers, name) for name in ("combined", "depth", *_MATTES, "normal")}
    shapes = {"combined": (*size, 4), "normal": (*size, 3)}
    if layers.cryptomatte is not None:
        arrays["cryptomatte"] = layers.cryptomatte.coverage
        shapes["cryptomatte"] = (*size, len(layers.cryptomatte.names))
    for name, array in arrays.items():
        if array is None:
            continue
        if array.shape != shapes.get(name, size):
            raise ExrError(f"{name} has the shape {array.shape}, expected {shapes.get(name, size)} as combined")
        if not np.isfinite(array).all():
            count = int((~np.isfinite(array)).sum())
            raise ExrError(f"{name} has {count} values that are not finite; such a frame would spoil a composite")
