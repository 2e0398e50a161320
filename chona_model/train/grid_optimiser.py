"""The optimisers of a grid model: Adam on perceptrons, light and skinning, and on the tables' rows in use."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from chona_model.grid_model import GridModel
from chona_model.kernels.cpu.adam import adam_rows
from chona_model.kernels.grid import FEATURES
from chona_model.kernels.threads import in_pieces
from chona_model.train.adam_state import adam_tensors, restore_adam
from chona_model.train.fast_settings import FastSettings

ADAM_PIECE = 1 << 17
"""Rows of the tables that a thread updates at once."""

BETAS = (0.9, 0.99)
EPSILON = 1e-15

WARM_UP = 10
"""Steps over which the rates rise."""


class GridOptimiser:
    """Steps of all parameters of a model.

    Args:
        model: whose gradients are there when ``step`` is called.
        settings: rates and how they fall.
        fused: the tables' gradients come from the kernels, row by row; otherwise they are tensors like the others'.
        learned: persons whose skinning is learned; where it is not None, nothing that identities share is.
    """

    def __init__(
        self, model: GridModel, settings: FastSettings, fused: bool, learned: Sequence[int] | None = None
    ) -> None:
        field = model.field
        volumes = model.volumes if learned is None else nn.ModuleList(model.volumes[index] for index in learned)
        self.model, self.settings, self.fused = model, settings, fused
        perceptrons = [value for name, value in field.named_parameters() if name not in {"table", "light"}]
        logits = [value for name, value in volumes.named_parameters() if name.endswith("logits")]
        offsets = [value for name, value in volumes.named_parameters() if "offset" in name]
        shared = learned is None
        groups = [
            {"params": perceptrons if shared else [], "lr": settings.mlp_rate},
            {"params": [field.light] if shared else [], "lr": settings.light_rate},
            {"params": logits, "lr": settings.skin_rate},
            {"params": offsets, "lr": settings.offset_rate},
        ]
        if not fused:
            groups.append({"params": [field.table], "lr": settings.grid_rate})
        self._rates = [float(group["lr"]) for group in groups]  # type: ignore[arg-type]
        self._adam = torch.optim.Adam(groups, betas=BETAS, eps=EPSILON, fused=True)
        moments = field.table.shape if fused else (0,)
        self._mean, self._square = (np.zeros(moments, dtype=np.float32) for _ in range(2))

    @property
    def parameters(self) -> list[nn.Parameter]:
        """All that ``step`` changes, but tables whose gradients come from the kernels."""
        return [parameter for group in self._adam.param_groups for parameter in group["params"]]

    def clear(self) -> None:
        """Forgets gradients; the tables' are cleared by ``step``."""
        self.model.zero_grad(set_to_none=True)

    def step(self, index: int, share: float) -> None:
        """One step of everything that has a gradient.

        Args:
            index: number of the step, from 0; share: how much of the schedule is done, 0…1.
        """
        decay = self.settings.last_rate ** min(share, 1.0) * min(1.0, (index + 1) / WARM_UP)
        for group, rate in zip(self._adam.param_groups, self._rates, strict=True):
            group["lr"] = rate * decay
        self._adam.step()
        if not self.fused:
            return
        field = self.model.field
        rows = [array.reshape(-1, FEATURES) for array in (
            field.table.detach().numpy(), field.gradient.buffer.numpy(), self._mean, self._square,
        )]  # fmt: skip
        corrections = (1.0 - BETAS[0] ** (index + 1), 1.0 - BETAS[1] ** (index + 1))
        factors = [np.float32(value) for value in (self.settings.grid_rate * decay, *BETAS, EPSILON, *corrections)]
        touched = field.gradient.touched
        in_pieces(lambda begin, end: adam_rows(begin, end, *rows, touched, *factors), len(touched), ADAM_PIECE)

    def tensors(self) -> dict[str, Tensor]:
        """All moments by name; not copied."""
        moments = {"grid.mean": torch.from_numpy(self._mean), "grid.square": torch.from_numpy(self._square)}
        return moments | adam_tensors(self._adam)

    def restore(self, state: dict[str, Tensor]) -> None:
        """Takes moments back from a trainer's state."""
        self._mean[:], self._square[:] = state["grid.mean"].numpy(), state["grid.square"].numpy()
        restore_adam(self._adam, state)
