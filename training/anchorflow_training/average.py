"""The exponential moving average of a model's weights, which is what is used after training."""

from __future__ import annotations

import torch
from torch import Tensor, nn


@torch.no_grad()
def update_average(
    average: dict[str, Tensor], model: nn.Module, *, decay: float, step: int
) -> None:
    """Move the average towards the weights, in place; early in a run it follows faster."""
    share = 1 - min(decay, (1 + step) / (10 + step))
    for name, value in model.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, share)
        else:
            average[name].copy_(value)
