"""Tensors out of a safetensors file one by one, or some of their rows, and what of the file was read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import torch
from safetensors import safe_open
from torch import Tensor

_BYTES = {"BOOL": 1, "U8": 1, "I8": 1, "I16": 2, "F16": 2, "BF16": 2, "I32": 4, "F32": 4, "I64": 8, "F64": 8}


@dataclass(frozen=True)
class IdentityRows:
    """Places of the chosen identities among all that a model file holds.

    Attributes:
        persons, objects: rows of the file's codes and boxes; of_persons, of_objects: how many the file holds.
    """

    persons: tuple[int, ...]
    objects: tuple[int, ...]
    of_persons: int
    of_objects: int


class TensorReader:
    """An open safetensors file, of which nothing but what is asked for is read.

    Attributes:
        read: bytes taken of each tensor that was touched, by name.

    Raises:
        SafetensorError: the file is no safetensors file, or lacks a tensor that is asked for.
        ValueError: a tensor holds numbers that are not finite.
    """

    def __init__(self, path: Path) -> None:
        self._file: Any = safe_open(path, framework="pt", device="cpu")
        self.names: frozenset[str] = frozenset(self._file.keys())
        self.read: dict[str, int] = {}

    def __enter__(self) -> TensorReader:
        self._file.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.__exit__(kind, error, trace)

    def __getitem__(self, name: str) -> Tensor:
        """A whole tensor, in memory of its own: the file may be written over while the tensor is in use."""
        return self._taken(name, self._file.get_tensor(name).clone())

    def shape(self, name: str) -> tuple[int, ...]:
        """A tensor's shape; nothing of it is read."""
        return tuple(self._file.get_slice(name).get_shape())

    def rows(self, name: str, rows: Sequence[int]) -> Tensor:
        """Rows of a tensor [N, …], as [len(rows), …]; the others are not read."""
        view = self._file.get_slice(name)
        parts = [view[row : row + 1] for row in rows] or [view[:0]]
        return self._taken(name, torch.cat(parts))

    def columns(self, name: str, count: int) -> Tensor:
        """The first ``count`` columns of a tensor [N, K]; of the others nothing is kept."""
        return self._taken(name, self._file.get_slice(name)[:, :count])

    def under(self, prefix: str) -> list[str]:
        """What follows ``prefix`` in the names that begin with it, sorted."""
        return sorted(name.removeprefix(prefix) for name in self.names if name.startswith(prefix))

    @property
    def total_bytes(self) -> int:
        """Bytes of all tensors in the file."""
        views = [self._file.get_slice(name) for name in self.names]
        return sum(_BYTES[view.get_dtype()] * torch.Size(view.get_shape()).numel() for view in views)

    def expect(self, name: str, shape: tuple[int, ...], dtype: str = "F") -> None:
        """Checks a tensor before any memory is asked for it, or for what is as large as it.

        Args:
            dtype: how the safetensors name of its type begins, such as ``F`` or ``I32``.

        Raises:
            ValueError: it has another shape or type.  SafetensorError: there is none.
        """
        view = self._file.get_slice(name)
        found, kind = tuple(view.get_shape()), view.get_dtype()
        if found != shape or not kind.startswith(dtype):
            raise ValueError(f"'{name}' is {kind} {list(found)}, expected {dtype} {list(shape)}")

    def _taken(self, name: str, tensor: Tensor) -> Tensor:
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            raise ValueError(f"'{name}' holds numbers that are not finite")
        self.read[name] = self.read.get(name, 0) + tensor.numel() * tensor.element_size()
        return tensor
