"""The scene's own frame: origin halfway between start and goal, x axis towards the goal.

In it every scene asks the same question, from left to right; the window that the network sees is
a square of half side h = 0.5 L + 1.8 m around the origin, where L is the distance to the goal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.layers.geometry import in_float32
from anchorflow_trajectory.routes.splines import LEAST_SPREAD, MOST_SPREAD, SPREAD_SHARE

WINDOW_SHARE = 0.5
WINDOW_MARGIN = 1.8  # m


@dataclass(frozen=True)
class Frame:
    """rotation: [B, D, D], columns are the axes (a third dimension, heading, is not turned);
    centre: [B, D], m; half_size: [B] m."""

    rotation: Tensor
    centre: Tensor
    half_size: Tensor

    @staticmethod
    def between(start: Tensor, goal: Tensor) -> Frame:
        """Return the frame of starts and goals [B, D], not turned if they coincide."""
        span = (goal - start)[:, :2]
        length = span.square().sum(-1).clamp(min=1e-12).sqrt()
        east = torch.tensor([1.0, 0.0], device=span.device)
        axis = torch.where((length > 1e-3)[:, None], span / length[:, None], east)
        rotation = torch.stack([axis, torch.stack([-axis[:, 1], axis[:, 0]], -1)], -1)
        if start.shape[1] == 3:
            rotation = F.pad(rotation, (0, 1, 0, 1))
            rotation = rotation + torch.diag(torch.tensor([0.0, 0.0, 1.0], device=span.device))
        return Frame(rotation, 0.5 * (start + goal), WINDOW_SHARE * length + WINDOW_MARGIN)

    def pack(self) -> Tensor:
        """[B, D^2 + D + 1], as a graph carries it."""
        return torch.cat([self.rotation.flatten(1), self.centre, self.half_size[:, None]], -1)

    @staticmethod
    def unpack(packed: Tensor, dim: int) -> Frame:
        rotation, centre, half_size = packed.split([dim * dim, dim, 1], -1)
        return Frame(rotation.reshape(-1, dim, dim), centre, half_size[:, 0])

    @property
    def spread(self) -> Tensor:
        """[B] m by which trajectories between these ends are disturbed: `usual_spread`."""
        way = (self.half_size - WINDOW_MARGIN) / WINDOW_SHARE
        return (SPREAD_SHARE * way).clamp(LEAST_SPREAD, MOST_SPREAD)

    def widened(self, factor: float) -> Frame:
        """The same axes around a window that is `factor` times as wide."""
        return Frame(self.rotation, self.centre, factor * self.half_size)

    def turn_in(self, vectors: Tensor) -> Tensor:
        """Map-frame vectors [B, ..., D] in the scene's axes."""
        return _turn(vectors, self.rotation)

    def turn_out(self, vectors: Tensor) -> Tensor:
        """Vectors [B, ..., D] in the scene's axes back in the map's."""
        return _turn(vectors, self.rotation.transpose(1, 2))

    def place(self, points: Tensor) -> Tensor:
        """Map-frame points [B, P, 2] in m as window coordinates in [-1, 1]."""
        offset = points - self.centre[:, None, :2]
        return _turn(offset, self.rotation[:, :2, :2]) / self.half_size[:, None, None]

    def window(self, size: int) -> Tensor:
        """Map-frame points of the window's cell centres, row by row: [B, size^2, 2] in m."""
        line = (torch.arange(size, device=self.centre.device) + 0.5) * (2.0 / size) - 1.0
        y, x = torch.meshgrid(line, line, indexing="ij")
        grid = torch.stack([x, y], -1).reshape(1, -1, 2) * self.half_size[:, None, None]
        return _turn(grid, self.rotation[:, :2, :2].transpose(1, 2)) + self.centre[:, None, :2]


@in_float32
def _turn(vectors: Tensor, rotation: Tensor) -> Tensor:
    """v R for every vector in [B, ..., D]."""
    flat = vectors.reshape(vectors.shape[0], -1, vectors.shape[-1])
    return (flat @ rotation).reshape(vectors.shape)


USUAL_HALF_SIZE = 5.0  # m


class Limits(NamedTuple):
    """Limits of B scenes, [B] each: m/s, m/s^2, m, and s, 0 if anchors choose their durations."""

    v_max: Tensor
    a_max: Tensor
    robot_radius: Tensor
    horizon_s: Tensor

    @staticmethod
    def of(packed: Tensor) -> Limits:
        """Unpack [B, 4]."""
        return Limits(*packed.unbind(-1))


class ConditionEncoder(nn.Module):
    """Ends, style, limits and scale of a scene -> [B, width].

    Velocities and accelerations are in the scene's axes and in shares of their limits, the limits
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
