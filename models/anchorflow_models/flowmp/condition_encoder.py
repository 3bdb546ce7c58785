"""What the robot is doing and wants, as one vector."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.frame import Frame


class ConditionEncoder(nn.Module):
    """Start, goal, start velocity, style and scale of a scene -> [B, width].

    Velocities and accelerations come in the scene's axes and in shares of their limits.
    """

    def __init__(self, config: L2Config, width: int) -> None:
        super().__init__()
        self.config = config
        self.mlp = nn.Sequential(
            nn.Linear(3 * config.dim + 3 + 2, width), nn.SiLU(), nn.Linear(width, width)
        )

    def forward(self, frame: Frame, x_curr: Tensor, x_goal: Tensor, w_style: Tensor) -> Tensor:
        dim = self.config.dim
        velocity, acceleration = x_curr[:, dim : 2 * dim], x_curr[:, 2 * dim :]
        parts = [
            frame.turn_in(velocity) / self.config.v_max,
            frame.turn_in(acceleration) / self.config.a_max,
            frame.turn_in(x_goal[:, dim:]) / self.config.v_max,
            w_style,
            frame.half_size[:, None] / (self.config.v_max * self.config.horizon_s),
            1.0 / frame.half_size[:, None],
        ]
        return self.mlp(torch.cat(parts, -1))
