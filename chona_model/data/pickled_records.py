"""Records of what a pickle names, and the numpy arrays that they become once the pickle has been read whole.

Shapes, types and indices are checked here, so that neither numpy's own ``__setstate__`` nor scipy's C code sees data
from the file; see ``restricted_pickle.py``.
"""

from __future__ import annotations

import math
import pickle
import re
from typing import Any

import numpy as np

SPARSE_BYTES = 1 << 28
"""Limit for a sparse matrix made dense (SMPL's joint regressor has 1.3 MB)."""

_SIMPLE_KINDS = "?bhilqBHILQefdgFDSUac"
"""numpy type letters without Python objects, structures or dates."""
_TYPE = re.compile(r"[A-Za-z?]\d{0,9}")
_MOST_DIMENSIONS = 32


class Refused(pickle.UnpicklingError):
    """A pickle names something that is not admitted."""


class Record:
    """Stands in for an instance of a class that is not imported; keeps what the file says about it."""

    label = "object"

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments
        self.state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state


class PickledArray(Record):
    """An array: its state holds shape, type and bytes."""

    label = "numpy.ndarray"


class PickledType(Record):
    """An array's type: numpy's letter and size, and the order of bytes."""

    label = "numpy.dtype"


class PickledScalar(Record):
    """A single number: its type and bytes."""

    label = "numpy scalar"


class PickledBuffer(Record):
    """An array as protocol 5 writes it: bytes, type, shape and order."""

    label = "numpy._frombuffer"


class PickledSparse(Record):
    """A matrix compressed by rows or columns."""

    label = "scipy.sparse matrix"


class PickledChumpy(Record):
    """An array as SMPL's own library wraps it."""

    label = "chumpy array"


def to_arrays(content: Any) -> Any:
    """Plain containers with arrays in place of records.

    Raises:
        Refused: a record is none of an array, or says what no array can be.
    """
    return _plain(content, {})


def _plain(item: Any, done: dict[int, Any]) -> Any:
    """Turns records into arrays; each shared item once, so references cannot multiply memory."""
    if item is None or isinstance(item, bool | int | float | complex | str | bytes | bytearray):
        return item
    key = id(item)
    if key in done:
        if done[key] is _PENDING:
            raise Refused("a container that contains itself")
        return done[key]
    done[key] = _PENDING
    result: Any
    if isinstance(item, dict):
        result = {_hashable(name, done): _plain(value, done) for name, value in item.items()}
    elif isinstance(item, list | tuple):
        result = type(item)(_plain(value, done) for value in item)
    elif isinstance(item, set | frozenset):
        result = {_hashable(value, done) for value in item}
    elif isinstance(item, PickledArray):
        result = _array(item)
    elif isinstance(item, PickledBuffer):
        data, dtype, shape, order = item.arguments
        result = _filled(data, _dtype(dtype), shape, order)
    elif isinstance(item, PickledScalar):
        dtype, data = item.arguments
        result = _filled(data, _dtype(dtype), (), "C")[()]
    elif isinstance(item, PickledSparse):
        result = _sparse(item, _plain(item.state, done))
    elif isinstance(item, PickledChumpy):
        result = _chumpy(item, _plain(item.state, done))
    else:
        raise Refused(item.label if isinstance(item, Record) else type(item).__name__)
    done[key] = result
    return result


_PENDING = object()


def _hashable(item: Any, done: dict[int, Any]) -> Any:
    if isinstance(item, str | int | float | bytes):
        return item
    if isinstance(item, tuple):
        return tuple(_hashable(part, done) for part in item)
    raise Refused(f"a key of type {type(item).__name__}")


def _dtype(record: Any) -> np.dtype[Any]:
    letter = record.arguments[0] if isinstance(record, PickledType) else None
    letter = letter.decode("latin1") if isinstance(letter, bytes) else letter
    if not isinstance(letter, str) or not _TYPE.fullmatch(letter):
        raise Refused("an array of unknown type")
    dtype = np.dtype(letter)
    if dtype.char not in _SIMPLE_KINDS:
        raise Refused(f"an array of type {dtype} (Python objects or structures)")
    order = record.state[1] if isinstance(record.state, tuple) and len(record.state) > 1 else "|"
    return dtype.newbyteorder(">") if order in (">", b">") else dtype


def _array(record: PickledArray) -> np.ndarray:
    if not isinstance(record.state, tuple) or len(record.state) != 5:
        raise Refused("an array without contents")
    _, shape, dtype, fortran, data = record.state
    return _filled(data, _dtype(dtype), shape, "F" if fortran else "C")


def _filled(data: Any, dtype: np.dtype[Any], shape: Any, order: Any) -> np.ndarray:
    data = data.encode("latin1") if isinstance(data, str) else data
    if not isinstance(data, bytes | bytearray) or order not in ("C", "F"):
        raise Refused("an array without plain bytes")
    plain = isinstance(shape, tuple) and len(shape) <= _MOST_DIMENSIONS
    if not (plain and all(isinstance(length, int) and 0 <= length < 1 << 48 for length in shape)):
        raise Refused("an array of no possible shape")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise Refused(f"an array of shape {shape} and type {dtype} with {len(data)} bytes")
    array = np.frombuffer(data, dtype=dtype).reshape(shape, order=order)
    return array.astype(dtype.newbyteorder("="))


def _sparse(record: PickledSparse, state: Any) -> np.ndarray:
    """Dense array of a csc or csr matrix, its indices checked here and not by scipy's C code."""
    shape = state.get("_shape", state.get("shape")) if isinstance(state, dict) else None
    if not (isinstance(shape, tuple) and len(shape) == 2 and all(0 <= length < 1 << 48 for length in shape)):
        raise Refused(f"a {record.label} of no possible shape")
    if math.prod(shape) * 8 > SPARSE_BYTES:
        raise Refused(f"a {record.label} of shape {shape!r}, more than {SPARSE_BYTES} bytes")
    shape = (int(shape[0]), int(shape[1]))
    by_column = "csc" in record.label
    starts, indices, data = (np.asarray(state[name]).reshape(-1) for name in ("indptr", "indices", "data"))
    outer, inner = (shape[1], shape[0]) if by_column else shape
    sound = len(starts) == outer + 1 and len(indices) == len(data) and starts[0] == 0 and starts[-1] == len(data)
    if not sound or (np.diff(starts) < 0).any() or (len(indices) and not 0 <= indices.min() <= indices.max() < inner):
        raise Refused(f"a damaged {record.label}")
    dense = np.zeros((outer, inner))
    np.add.at(dense, (np.repeat(np.arange(outer), np.diff(starts)), indices), data)
    return dense.T if by_column else dense


def _chumpy(record: PickledChumpy, state: Any) -> np.ndarray:
    """The values of ``Ch`` (a constant array) and of ``Select`` (entries of one), as SMPL's files hold them."""
    if isinstance(state, dict) and isinstance(state.get("x"), np.ndarray):
        return state["x"]
    if isinstance(state, dict) and isinstance(state.get("a"), np.ndarray) and "idxs" in state:
        chosen = state["a"].reshape(-1)[np.asarray(state["idxs"], dtype=np.int64).reshape(-1)]
        shape = state.get("preferred_shape")
        return chosen.reshape(shape) if isinstance(shape, tuple) else chosen
    raise Refused(f"{record.label} (a chumpy expression, not a plain array)")
