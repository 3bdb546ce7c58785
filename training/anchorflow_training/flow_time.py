"""At which flow times the field is trained; t = 0 is noise, t = 1 is data."""

from __future__ import annotations

import torch
from torch import Tensor

from anchorflow_training.config import FlowMatchingConfig


def draw_flow_times(
    config: FlowMatchingConfig, shape: tuple[int, ...], generator: torch.Generator
) -> Tensor:
    """Flow times in [0, 1] of the given shape.

    uniform       every time alike
    logit_normal  sigmoid of a Gaussian: most between the ends (Esser et al., 2024)
    late          density k t^(k - 1), k = `late_power`: near the data, where schedules step most
    """
    if config.flow_time == "logit_normal":
        normal = torch.randn(shape, generator=generator)
        return torch.sigmoid(config.logit_mean + config.logit_std * normal)
    t = torch.rand(shape, generator=generator)
    return t ** (1.0 / config.late_power) if config.flow_time == "late" else t
