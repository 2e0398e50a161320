"""Linear layers over codes of which a part may be absent: what is absent is not multiplied."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import linear


def linear_of_present(layer: nn.Linear, code: Tensor) -> Tensor:
    """``layer`` of a code [1, K] up to its last number that is not zero; other batches as they are.

    Pose codes end with those of the pseudo bones, which are zeros where no object is.  So a model that was loaded for a
    person alone, whose layers never had those columns, gives the very numbers that the whole model gives.
    """
    if torch.is_grad_enabled() or len(code) != 1 or code.shape[1] > layer.in_features:
        return layer(code)
    used = code[0].nonzero()
    count = int(used[-1]) + 1 if len(used) else 0
    return linear(code[:, :count].contiguous(), layer.weight[:, :count].contiguous(), layer.bias)
