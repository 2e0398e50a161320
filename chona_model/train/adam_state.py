"""Adam's moments as named tensors, so that they fit into a checkpoint without a pickle."""

from __future__ import annotations

from torch import Tensor
from torch.optim import Optimizer

PREFIX = "adam."


def adam_tensors(optimiser: Optimizer) -> dict[str, Tensor]:
    """``adam.NUMBER.NAME`` of every parameter that has taken a step; not copied."""
    content = optimiser.state_dict()["state"]
    return {f"{PREFIX}{number}.{name}": value for number, values in content.items() for name, value in values.items()}


def restore_adam(optimiser: Optimizer, state: dict[str, Tensor]) -> None:
    """Takes moments back from a trainer's state, other names in which are passed over."""
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in state.items():
        if name.startswith(PREFIX):
            _, number, key = name.split(".")
            moments.setdefault(int(number), {})[key] = value
    optimiser.load_state_dict({"state": moments, "param_groups": optimiser.state_dict()["param_groups"]})
