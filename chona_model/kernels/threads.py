"""Pieces of work on all cores: numba functions that release Python's lock, called from a pool of threads.

Compiles several times faster than numba's own parallel loops.  How work is cut never depends on the number of threads,
so neither do results.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

from numba import get_num_threads, set_num_threads


def share_out(processes: int) -> int:
    """Leaves this process its share of the cores where several work on one computer, and returns their number.

    ``NUMBA_NUM_THREADS`` in the environment is a process's own number, whatever the others use.
    """
    if "NUMBA_NUM_THREADS" not in os.environ:
        set_num_threads(max(get_num_threads() // processes, 1))
    return get_num_threads()


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="chona")


if hasattr(os, "register_at_fork"):  # a child has none of its parent's threads
    os.register_at_fork(after_in_child=_pool.cache_clear)


def in_pieces(function: Callable[[int, int], Any], count: int, piece: int) -> list[Any]:
    """Calls ``function(begin, end)`` on pieces of ``range(count)`` on as many threads as numba uses.

    Args:
        function: releases Python's lock while it works (``njit(nogil=True)``); its pieces are independent.
        piece: length of all pieces but the last.

    Returns:
        What the calls returned, in order.
    """
    threads = get_num_threads()
    bounds = [(begin, min(begin + piece, count)) for begin in range(0, count, piece)]
    # Not in the main thread: where a signal raises an exception while numba makes tuples of results, it crashes.
    if (threads == 1 or len(bounds) == 1) and threading.current_thread() is not threading.main_thread():
        return [function(*bound) for bound in bounds]
    return list(_pool(threads).map(lambda bound: function(*bound), bounds))
