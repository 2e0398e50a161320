"""How kernels are compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

entry: Any = njit(nogil=True, cache=True)
"""Called from Python: releases its lock, keeps machine code between runs.  Allocates what inner functions work in."""

_any_njit: Any = njit  # its stub leaves ``_nrt`` out
RELAXED = {"nsz", "arcp", "contract", "afn", "reassoc"}
"""Sums may be reordered; infinities and NaNs keep their meaning."""

_INSIDE = {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

inner = _any_njit(**_INSIDE, fastmath=RELAXED)
"""Called from other kernels alone: may not allocate, and does not count references to the arrays it is given.  Counting
is a locked instruction for every array of every call, and cores fight over the counters."""

inlined = _any_njit(**_INSIDE, fastmath=RELAXED, forceinline=True)
"""``inner`` for a few lines that are called per point: their results would otherwise go through memory."""

strict = _any_njit(**_INSIDE, forceinline=True)
"""``inlined`` where every operation must round as it is written."""


@strict
def within(position, last):
    """A position on a grid's axis moved into 0…``last``; one that is not a number stays so."""
    zero = np.float32(0.0)
    position = zero if position < zero else position
    return last if position > last else position


@strict
def corner_of(position, corners):
    """The lower corner of a position's cell among ``corners`` of an axis.

    Whatever a conversion makes of a NaN, no index leaves the grid: memory is safe, and the NaN stays in the weights.
    """
    return min(max(np.int32(position), np.int32(0)), np.int32(corners) - np.int32(2))
