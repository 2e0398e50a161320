"""Reads pickles that only exist as pickles (body fits, SMPL files) without running anything they name.

Nothing that a pickle names is ever imported.  The few classes that such files contain (numpy arrays, dtypes and
scalars, scipy's compressed sparse matrices, chumpy's array wrappers) are stood in for by inert records
(``pickled_records.py``), which become numpy arrays after the file has been read whole and their contents checked.  So
not even numpy's own ``__setstate__``, which trusts shapes and type flags, sees data from the file.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO, ClassVar

import numpy as np

from chona_model.data.dataset import DatasetError
from chona_model.data.pickled_records import (
    PickledArray,
    PickledBuffer,
    PickledChumpy,
    PickledScalar,
    PickledSparse,
    PickledType,
    Record,
    Refused,
    to_arrays,
)
from chona_model.plain_json import shortened

FIT_BYTES = 1 << 20
"""Limit for one frame's fitted parameters (real ones have 2 to 30 kB)."""
MODEL_BYTES = 1 << 30
"""Limit for a body model (SMPL-H with 300 shape directions has about 300 MB)."""
MOST_STEPS = 2_000_000
"""Of a pickle: ZJU-MoCap's longest list of images takes a tenth."""


def _encode(text: object, encoding: object = "latin1") -> bytes:
    """``_codecs.encode`` as Python 2 pickles use it for bytes, for text and latin1 alone."""
    if not isinstance(text, str) or encoding != "latin1":
        raise Refused(f"_codecs.encode with the encoding {encoding!r}")
    return text.encode("latin1")


def _no_bytes(*arguments: object) -> bytes:
    """``bytes()`` as old protocols write empty bytes; never a length, which could ask for any amount of memory."""
    if arguments:
        raise Refused("bytes made from other objects")
    return b""


def _reconstructor(cls: object, _base: object, _state: object) -> Record:
    """``copy_reg._reconstructor`` of old protocols, for this module's records alone."""
    if not (isinstance(cls, type) and issubclass(cls, Record)):
        raise Refused(f"copy_reg._reconstructor of {cls!r}")
    return cls()


def _checked_keys(keys: Iterable[Any]) -> None:
    """Refuses keys whose hash could take for ever: a tuple of tuples of tuples is hashed to its last leaf."""
    for key in keys:
        if not isinstance(key, str | int | float | bytes):
            raise Refused(f"a key of type {type(key).__name__}")


def _ordered(items: Any = ()) -> dict[Any, Any]:
    """``collections.OrderedDict`` of a list of pairs."""
    pairs = [(key, value) for key, value in items]
    _checked_keys(key for key, _ in pairs)
    return dict(pairs)


def _set(items: Any = ()) -> set[Any]:
    """``set`` and ``frozenset`` of a list."""
    _checked_keys(items)
    return set(items)


class _NumpyClass:
    """``numpy.ndarray`` as an argument; never called."""


_ADMITTED: dict[str, Any] = {
    "_codecs.encode": _encode,
    "collections.OrderedDict": _ordered,
    **{
        f"{module}.{name}": kind
        for module in ("builtins", "__builtin__")
        for name, kind in (("set", _set), ("frozenset", _set), ("object", _NumpyClass), ("bytes", _no_bytes))
    },
    **{
        f"numpy.{core}.{name}": kind
        for core in ("core", "_core")
        for name, kind in (
            ("multiarray._reconstruct", PickledArray),
            ("multiarray.scalar", PickledScalar),
            ("numeric._frombuffer", PickledBuffer),
        )
    },
    "numpy.ndarray": _NumpyClass,
    "numpy.dtype": PickledType,
    "copy_reg._reconstructor": _reconstructor,
    "copyreg._reconstructor": _reconstructor,
}


class _File:
    """What an unpickler reads from: never asked for more than is there, nor more often than is sensible."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._steps = file, 0
        at = file.tell()
        self._end = file.seek(0, 2)
        file.seek(at)

    def read(self, count: int) -> bytes:
        self._steps += 1
        if self._steps > MOST_STEPS:
            raise Refused(f"more than {MOST_STEPS} steps")
        return self._file.read(min(count, self._end - self._file.tell()))

    def readline(self) -> bytes:
        return self._file.readline()


_PYTHONS: Any = pickle._Unpickler


class _Unpickler(_PYTHONS):
    """In Python: the one in C fills memory with what a file claims to remember, and cannot be told which keys to take.

    Its table of steps is copied, and the steps that hash or set what they are given look at it first.
    """

    dispatch: ClassVar[dict[int, Any]] = dict(_PYTHONS.dispatch)

    def _set_item(self) -> None:
        _checked_keys(self.stack[-2:-1])
        _PYTHONS.load_setitem(self)

    def _set_items(self) -> None:
        _checked_keys(self.stack[::2])
        _PYTHONS.load_setitems(self)

    def _make_dict(self) -> None:
        _checked_keys(self.stack[::2])
        _PYTHONS.load_dict(self)

    def _add_items(self) -> None:
        _checked_keys(self.stack)
        _PYTHONS.load_additems(self)

    def _make_frozenset(self) -> None:
        _checked_keys(self.stack)
        _PYTHONS.load_frozenset(self)

    def _make_bytearray(self) -> None:
        """As the base class does, which asks for the memory before it looks whether the file has so many bytes."""
        content = self.read(int.from_bytes(self.read(8), "little"))
        self.append(bytearray(content))

    def _build(self) -> None:
        if not isinstance(self.stack[-2], Record):
            raise Refused(f"a state for a {type(self.stack[-2]).__name__}")
        _PYTHONS.load_build(self)

    dispatch[pickle.SETITEM[0]], dispatch[pickle.SETITEMS[0]] = _set_item, _set_items
    dispatch[pickle.DICT[0]], dispatch[pickle.ADDITEMS[0]] = _make_dict, _add_items
    dispatch[pickle.BYTEARRAY8[0]] = _make_bytearray
    dispatch[pickle.FROZENSET[0]], dispatch[pickle.BUILD[0]] = _make_frozenset, _build

    def find_class(self, module: str, name: str) -> Any:
        admitted = _ADMITTED.get(f"{module}.{name}")
        if admitted is not None:
            return admitted
        if module.startswith("scipy.sparse") and name in ("csc_matrix", "csr_matrix", "csc_array", "csr_array"):
            return type(name, (PickledSparse,), {"label": f"{module}.{name}"})
        if module == "chumpy" or module.startswith("chumpy."):
            return type(name, (PickledChumpy,), {"label": f"{module}.{name}"})
        raise Refused(f"{module}.{name}")

    def persistent_load(self, pid: Any) -> Any:  # noqa: ARG002 - the name is the base class's
        raise Refused("a persistent id")


def read_pickle(path: Path, max_bytes: int = FIT_BYTES) -> Any:
    """The contents of a pickle made of numpy arrays and plain containers.

    Sparse matrices and chumpy's constant arrays come back as dense numpy arrays.  Text of Python 2 is read as latin1.

    Raises:
        DatasetError: the file is missing, too large, damaged, or holds anything else; the message names the class.
    """
    return _read(path, max_bytes, lambda file: _Unpickler(_File(file), encoding="latin1").load())


def read_object_npy(path: Path, max_bytes: int = FIT_BYTES) -> Any:
    """What ``numpy.save`` kept of one Python object (ZJU-MoCap's ``annots.npy``): see ``read_pickle``."""
    return _read(path, max_bytes, _unpacked_npy)


def _unpacked_npy(file: BinaryIO) -> Any:
    """The one Python object of a .npy; numpy's own reader would hand it to pickle."""
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"a .npy of version {version}, expected 1.0")
    shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    if shape != () or dtype != np.dtype(object):
        raise ValueError(
            f"an array of shape {shape} and type {dtype}, expected one Python object (numpy.save of a dict)"
        )
    holder = _Unpickler(_File(file), encoding="latin1").load()
    items = holder.state[4] if isinstance(holder, PickledArray) and isinstance(holder.state, tuple) else None
    if not isinstance(items, list) or len(items) != 1:
        raise Refused("something else than one object in an array without dimensions")
    return items[0]


def _read(path: Path, max_bytes: int, load: Callable[[BinaryIO], Any]) -> Any:
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise DatasetError(
                f"{path} has {size} bytes, at most {max_bytes} are expected of such a file; check that it "
                "is the right one"
            )
        with path.open("rb") as file:
            content = load(file)
        return to_arrays(content)
    except Refused as error:
        raise DatasetError(
            f"{path} holds {shortened(error)}, which is refused: only numpy arrays and plain containers are read from "
            "pickles; re-save the file with those alone (for a body model as .npz)"
        ) from error
    except OSError as error:
        raise DatasetError(f"cannot read {path}: {error}; expected a pickle of numpy arrays") from error
    except DatasetError:
        raise
    except Exception as error:  # a damaged pickle fails in any way it likes: the message must still name the file
        raise DatasetError(
            f"cannot read {path}: {type(error).__name__}: {shortened(error)}; expected a complete pickle of numpy "
            "arrays, copy the file again"
        ) from error
