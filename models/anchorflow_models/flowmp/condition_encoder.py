"""What the robot is doing, can and wants, as one vector."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.frame import Frame

USUAL_HALF_SIZE = 5.0  # m


class Limits(NamedTuple):
    """Of B scenes, each [B]: m/s, m/s^2, m, and s or 0 where every anchor has its own duration."""

    v_max: Tensor
    a_max: Tensor
    robot_radius: Tensor
    horizon_s: Tensor

    @staticmethod
    def of(packed: Tensor) -> Limits:
        """Of [B, 4]."""
        return Limits(*packed.unbind(-1))


class ConditionEncoder(nn.Module):
    """Ends, style, limits and scale of a scene -> [B, width].

    Velocities and accelerations come in the scene's axes and in shares of their limits, the limits
    and the robot's size in shares of the window's: a robot of half the speed and a quarter of the
    acceleration does the same in twice the time, and the network need not learn it.
    """

    def __init__(self, config: L2Config, width: int) -> None:
        super().__init__()
        self.config = config
        self.mlp = nn.Sequential(
            nn.Linear(3 * config.dim + 3 + 6, width), nn.SiLU(), nn.Linear(width, width)
        )

    def forward(
        self, frame: Frame, x_curr: Tensor, x_goal: Tensor, w_style: Tensor, limits: Tensor
    ) -> Tensor:
        dim, robot, half = self.config.dim, Limits.of(limits), frame.half_size
        velocity, acceleration = x_curr[:, dim : 2 * dim], x_curr[:, 2 * dim :]
        scale = [
            torch.log(half / USUAL_HALF_SIZE),
            1.0 / half,
            robot.robot_radius,
            robot.robot_radius / half,
            0.5 * torch.log(robot.a_max * half / robot.v_max.square()),
            (robot.horizon_s > 0).to(half),
        ]
        parts = [
            frame.turn_in(velocity) / robot.v_max[:, None],
            frame.turn_in(acceleration) / robot.a_max[:, None],
            frame.turn_in(x_goal[:, dim:]) / robot.v_max[:, None],
            w_style,
            torch.stack(scale, -1),
        ]
        return self.mlp(torch.cat(parts, -1))
