"""How a process that torchrun has started joins the others, and how they part: on every computer one of them tells
what went wrong, and the others are silent."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta

import torch
import torch.distributed as dist

from chona_model.kernels.threads import share_out
from chona_model.launch import Launch, read_launch
from chona_model.progress import Cancelled, Progress
from chona_model.train.together import CompanionLost, wait_for_all

LEADER_FIRST = timedelta(seconds=3)
"""How long the others leave it to the first process to tell that one is lost: it may know what is kept."""

FIRST_ERROR = "first error"


@contextmanager
def joined(progress: Progress) -> Iterator[None]:
    """Makes this process one of those that train together while the block runs; all of them leave it together.

    Args:
        progress: made quiet or not, by whether it is for this process to tell of an error.

    Raises:
        whatever the block raises; ``CompanionLost`` where another process has failed.
    """
    launch = read_launch()
    torch.set_num_threads(share_out(launch.local_size))
    store = _meet(launch)
    try:
        yield
        wait_for_all()
    except Cancelled:
        # Where a process has failed it is the launcher that ends the others: the user has asked for nothing.
        with suppress(RuntimeError):
            progress.quiet |= store.check([FIRST_ERROR])
        raise
    except Exception as error:
        told = _first_error(store, launch, error)
        own = told == _told(error)
        progress.quiet = not own and (launch.local_rank > 0 or told["host"] == platform.node())
        if own or progress.quiet:
            raise
        raise CompanionLost(f"on {told['host']}: {told['message']}") from error
    dist.destroy_process_group()


def _meet(launch: Launch) -> dist.Store:
    """Waits for all processes; returns the store that they share, which the launcher keeps."""
    store, rank, size = next(iter(dist.rendezvous("env://")))
    store = dist.PrefixStore(f"attempt {launch.attempt}", store)
    backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
    group = dist.PrefixStore("group", store)
    dist.init_process_group(backend, store=group, rank=rank, world_size=size)
    return store


def _told(error: Exception) -> dict[str, str]:
    rank = str(read_launch().rank)
    return {"host": platform.node(), "rank": rank, "message": str(error) or type(error).__name__}


def _first_error(store: dist.Store, launch: Launch, error: Exception) -> dict[str, str]:
    """The error that any process told of first, which is this one's where none has."""
    own = _told(error)
    try:
        if isinstance(error, CompanionLost) and launch.rank > 0:
            with suppress(dist.DistStoreError):
                store.wait([FIRST_ERROR], LEADER_FIRST)
        return json.loads(store.compare_set(FIRST_ERROR, "", json.dumps(own)))
    except RuntimeError:  # the launcher that keeps the store is gone as well
        return own
