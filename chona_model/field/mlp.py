"""Perceptrons with a condition that belongs to a pose or an identity rather than to a point, and exact tangents."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


def dense(inputs: int, outputs: int) -> nn.Linear:
    """A linear layer with Xavier-uniform weights and zero bias."""
    layer = nn.Linear(inputs, outputs)
    nn.init.xavier_uniform_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def conditioned_linear(layer: nn.Linear, x: Tensor, condition: Tensor | None, index: Tensor | None) -> Tensor:
    """``layer`` applied to x and a condition side by side, the condition's share computed once for each of its rows.

    Args:
        x: [M, D].
        condition: [U, C] or None; C = layer.in_features - D.
        index: [M] row of the condition for each point; None where U is 1 or M.

    Returns:
        [M, layer.out_features].
    """
    if condition is None:
        return layer(x)
    split = x.shape[-1]
    fixed = functional.linear(condition, layer.weight[:, split:], layer.bias)
    if index is not None and len(fixed) > 1:
        fixed = fixed.index_select(0, index)
    return functional.linear(x, layer.weight[:, :split]) + fixed


class ConditionedMLP(nn.Module):
    """ReLU layers of one width; points and condition enter at the first layer and again after layer ``skip``.

    Args:
        inputs: features of a point.
        width, depth: of the hidden layers.
        condition: features of the condition, 0 for none.
        skip: the input is appended after this hidden layer (counted from 0), as NeRF's; none if depth ≤ skip + 1.
        outputs: size of the final linear layer, or None to return hidden features (``feature_size`` of them).
    """

    def __init__(
        self, inputs: int, width: int, depth: int, *, condition: int = 0, skip: int = 4, outputs: int | None = None
    ) -> None:
        super().__init__()
        self.skip = skip
        self.layers = nn.ModuleList()
        for number in range(depth):
            again = inputs + condition if number in (0, skip + 1) else 0
            self.layers.append(dense((width if number else 0) + again, width))
        self.feature_size = width
        self.output = None if outputs is None else dense(width, outputs)

    def forward(self, x: Tensor, condition: Tensor | None = None, index: Tensor | None = None) -> Tensor:
        """[M, inputs] (and the condition's rows [U, C] with their index [M]) to [M, outputs or feature_size]."""
        hidden = x
        for number, layer in enumerate(self.layers):
            if number in (0, self.skip + 1):
                hidden = x if number == 0 else torch.cat([hidden, x], dim=-1)
                hidden = functional.relu(conditioned_linear(_linear(layer), hidden, condition, index))
            else:
                hidden = functional.relu(layer(hidden))
        return hidden if self.output is None else self.output(hidden)

    def with_tangents(
        self, x: Tensor, tangents: Tensor, condition: Tensor | None = None, index: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Value and directional derivatives in one pass forwards.

        Args:
            x: [M, inputs].
            tangents: [D, M, inputs] derivatives of x by D variables.

        Returns:
            [M, outputs] and its derivatives [D, M, outputs].
        """
        hidden, moving = x, tangents
        for number, module in enumerate(self.layers):
            layer = _linear(module)
            if number in (0, self.skip + 1):
                if number:
                    hidden, moving = torch.cat([hidden, x], dim=-1), torch.cat([moving, tangents], dim=-1)
                before = conditioned_linear(layer, hidden, condition, index)
            else:
                before = layer(hidden)
            change = functional.linear(moving, layer.weight[:, : moving.shape[-1]])
            hidden = functional.relu(before)
            # sign() of what ReLU left is its derivative, and several times faster here than a mask of booleans.
            moving = change.mul_(hidden.sign())
        if self.output is None:
            return hidden, moving
        return self.output(hidden), functional.linear(moving, self.output.weight)


def _linear(module: nn.Module) -> nn.Linear:
    assert isinstance(module, nn.Linear)
    return module
