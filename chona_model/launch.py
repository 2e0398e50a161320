"""What ``torchrun`` tells a process that it has started: how many there are, and which of them this one is."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass

UNNAMED = "none"
"""torchrun's name for a job that the user has given none."""


@dataclass(frozen=True)
class Launch:
    """A process among those of one job; without torchrun, one that is alone.

    Attributes:
        rank, size: its number, and how many there are; local_rank, local_size: the same on this computer.
        attempt: how often the job was started anew; attempts_left: how often it still may be.
        job: what tells this job from others, the same in all of its attempts; empty without torchrun.
    """

    rank: int = 0
    size: int = 1
    local_rank: int = 0
    local_size: int = 1
    attempt: int = 0
    attempts_left: int = 0
    job: str = ""


def read_launch() -> Launch:
    """This process's launch, from the environment."""
    name = os.environ.get("TORCHELASTIC_RUN_ID", "")
    if not name:
        return Launch()
    rank, size, local_rank, local_size, attempt, attempts = (
        int(os.environ[key])
        for key in ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE", "TORCHELASTIC_RESTART_COUNT",
                    "TORCHELASTIC_MAX_RESTARTS")
    )  # fmt: skip
    # The launcher outlives the processes that it starts, so it tells one job from the next.
    job = name if name != UNNAMED else f"{platform.node()}:{os.getppid()}"
    return Launch(rank, size, local_rank, local_size, attempt, max(attempts - attempt, 0), job)
