"""Several processes that train one model: each traces its share of a step's rays, and their gradients are summed.

Every process draws the whole batch, which depends on seed and step alone: poses, rays, jitter and exchanged codes.  The
rays of the others are misses to it, and losses are sums over rays divided by the number of all of them.  So the sum
over the processes is what one process would have, but for the order of additions.  What the clock, the user or the disk
decides, the first process decides for all.

Plain sums, not ``DistributedDataParallel``: the tables' gradients belong to the kernels and not to autograd, and only
the rows that rays have touched need to travel.  A process that is alone passes through all of this unchanged.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import torch
import torch.distributed as dist
from safetensors.torch import load, save
from torch import Tensor, nn

from chona_model.kernels.grid import FEATURES, TableGradient
from chona_model.train.errors import TrainingError

LEADER = 0


class CompanionLost(TrainingError):
    """Another process of the training does not answer."""


class Restorable(Protocol):
    """What of a trainer is sent to other processes."""

    def state(self) -> dict[str, Tensor]: ...
    def restore(self, state: dict[str, Tensor], done: int) -> None: ...


def size() -> int:
    """How many processes train together; 1 for a process that is alone."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def leads() -> bool:
    """Whether this is the process that decides, writes and reports."""
    return size() == 1 or dist.get_rank() == LEADER


def share() -> float:
    """This process's share of a loss that all of them compute whole."""
    return 1.0 / size()


def mine(count: int) -> np.ndarray:
    """[count] bool which rays of a step this process traces: every ``size()``-th."""
    return np.arange(count) % size() == (dist.get_rank() if size() > 1 else 0)


def sums(*values: float) -> tuple[float, ...]:
    """Each value summed over all processes."""
    if size() == 1:
        return values
    return tuple(_reduced(torch.tensor(values, dtype=torch.float64)).tolist())


def add_up(parameters: Sequence[nn.Parameter], table: TableGradient | None = None) -> None:
    """Sums the gradients of all processes, in place: of parameters, and of the rows of a table that any of them has
    touched.  A parameter without a gradient in all of them keeps none."""
    if size() == 1:
        return
    present = np.array([parameter.grad is not None for parameter in parameters], dtype=np.uint8)
    touched = np.zeros(0, dtype=np.uint8) if table is None else table.touched
    bits = _reduced(torch.from_numpy(np.packbits(np.concatenate([present, touched]))), union=True).numpy()
    present, touched = np.split(np.unpackbits(bits, count=len(present) + len(touched)), [len(present)])
    pieces = []
    for parameter, wanted in zip(parameters, present, strict=True):
        if wanted:
            own = torch.zeros_like(parameter) if parameter.grad is None else parameter.grad.contiguous()
            parameter.grad = own
            pieces.append(own.view(-1))
    rows = np.flatnonzero(touched)
    if table is not None:
        pieces.append(table.buffer.view(-1, FEATURES)[torch.from_numpy(rows)].view(-1))
    total = _reduced(torch.cat(pieces)).split([len(piece) for piece in pieces])
    for piece, summed in zip(pieces, total, strict=True):
        piece.copy_(summed)
    if table is not None:
        table.buffer.numpy().reshape(-1, FEATURES)[rows] = pieces[-1].view(-1, FEATURES).numpy()
        table.touched[rows] = 1


def copy_of_leader(array: np.ndarray) -> None:
    """Makes an array, in place, what it is in the first process."""
    if size() > 1:
        _sent(torch.from_numpy(array))


def agree(stop: bool, done: float, saved: int | None) -> tuple[bool, float, int | None]:
    """Whether any process was told to stop; and what the first one says of the share of the schedule that is ``done``
    and of the step of the checkpoint."""
    if size() == 1:
        return stop, done, saved
    word = [done, -1.0 if saved is None else float(saved)] if leads() else [0.0, 0.0]
    stops, done, step = _reduced(torch.tensor([float(stop), *word], dtype=torch.float64)).tolist()
    return stops > 0, done, None if step < 0 else int(step)


def wait_for_all() -> None:
    """Returns when all processes have come here."""
    sums(0.0)


def same_state(trainer: Restorable, position: dict[str, Any]) -> dict[str, Any]:
    """Gives all processes the first one's state, whatever they made of data and seed, and returns its position.

    Like processors come to the same state by themselves; then nothing but its digest travels.

    Args:
        position: where the run is; ``step`` is the number of steps done.
    """
    if size() == 1:
        return position
    content = save(trainer.state())
    own = torch.frombuffer(bytearray(hashlib.sha256(content).digest()), dtype=torch.uint8)
    differs = not torch.equal(own, _sent(own.clone()))
    (differing,) = sums(float(differs))
    position = json.loads(_bytes_of_leader(json.dumps(position).encode()))
    if differing:
        content = _bytes_of_leader(content)
        if differs:
            trainer.restore(load(content), int(position["step"]))
    return position


def _bytes_of_leader(content: bytes) -> bytes:
    length = int(_sent(torch.tensor([len(content)])))
    room = bytearray(content) if leads() else bytearray(length)
    _sent(torch.frombuffer(room, dtype=torch.uint8))
    return bytes(room)


def _reduced(tensor: Tensor, union: bool = False) -> Tensor:
    """The sum of all processes' tensors, or the union of their bits, in place."""
    try:
        dist.all_reduce(tensor, op=dist.ReduceOp.BOR if union else dist.ReduceOp.SUM)
    except RuntimeError as error:
        raise _lost() from error
    return tensor


def _sent(tensor: Tensor) -> Tensor:
    """The first process's tensor, in place."""
    try:
        dist.broadcast(tensor, src=LEADER)
    except RuntimeError as error:
        raise _lost() from error
    return tensor


def _lost() -> CompanionLost:
    return CompanionLost(
        "another process of this training is gone: it was killed, ran out of memory, or its computer is not reached"
    )
