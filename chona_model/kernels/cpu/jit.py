"""How kernels are compiled."""

from __future__ import annotations

from typing import Any

from numba import njit

entry: Any = njit(nogil=True, cache=True)
"""Called from Python: releases its lock, keeps machine code between runs.  Allocates what inner functions work in."""

_any_njit: Any = njit  # its stub leaves ``_nrt`` out
_RELAXED = {"nsz", "arcp", "contract", "afn", "reassoc"}

_INSIDE = {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

inner = _any_njit(**_INSIDE, fastmath=_RELAXED)
"""Called from other kernels alone: may not allocate, and does not count references to the arrays it is given.  Counting
is a locked instruction for every array of every call, and cores fight over the counters.

Sums may be reordered; infinities and NaNs keep their meaning."""

inlined = _any_njit(**_INSIDE, fastmath=_RELAXED, forceinline=True)
"""``inner`` for a few lines that are called per point: their results would otherwise go through memory."""

strict = _any_njit(**_INSIDE, forceinline=True)
"""``inlined`` where every operation must round as it is written."""
