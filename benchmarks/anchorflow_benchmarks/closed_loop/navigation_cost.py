"""What a motion costs: the same for every sample and every contender."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_benchmarks.closed_loop.robots import Robot
from anchorflow_trajectory.clearance import distance_to_cells


@dataclass(frozen=True, eq=False)
class ClearanceGrid:
    """values: [H*W] m beyond the robot's radius at cell centres; columns: W; origin: [2] m."""

    values: Tensor
    columns: int
    resolution: float
    origin: tuple[float, float]

    @staticmethod
    def of(
        occupied: NDArray[np.bool_],
        *,
        resolution: float,
        origin: NDArray[np.floating],
        robot_radius: float,
    ) -> ClearanceGrid:
        """Of a local map [H, W]: its edge is no obstacle, what lies beyond is not known."""
        most = max(occupied.shape) * resolution
        outside = np.minimum(distance_to_cells(occupied, resolution), most)
        inside = np.minimum(distance_to_cells(~occupied, resolution), most)
        values = torch.from_numpy((outside - inside - robot_radius).astype(np.float32))
        return ClearanceGrid(
            values.reshape(-1), occupied.shape[1], resolution, (float(origin[0]), float(origin[1]))
        )

    def at(self, x: Tensor, y: Tensor) -> Tensor:
        """m at points of any shape, bilinear; beyond the map as on its edge."""
        rows = len(self.values) // self.columns
        u = ((x - self.origin[0]) / self.resolution - 0.5).clamp(0.0, self.columns - 1.001)
        v = ((y - self.origin[1]) / self.resolution - 0.5).clamp(0.0, rows - 1.001)
        column, row = u.floor(), v.floor()
        index = (row * self.columns + column).long()
        share_u, share_v = u - column, v - row
        near, right = self.values[index], self.values[index + 1]
        above = self.values[index + self.columns]
        far = self.values[index + self.columns + 1]
        low = near + (right - near) * share_u
        return low + (above + (far - above) * share_u - low) * share_v


@dataclass(frozen=True)
class NavigationCost:
    """J = sum_t dt (collision + nearness + distance + effort + reversing) + terminal distance.

    margin: m of clearance below which a state counts as a collision
    comfort: m of clearance, beyond the margin, from which more is worth nothing
    """

    margin: float = 0.05
    comfort: float = 0.3
    collision: float = 100.0
    nearness: float = 2.0
    distance: float = 0.1
    effort: float = 0.02
    reversing: float = 0.5
    terminal: float = 3.0

    def of(
        self,
        robot: Robot,
        states: Tensor,
        controls: Tensor,
        *,
        grid: ClearanceGrid,
        goal: Tensor,
        dt: float,
    ) -> Tensor:
        """J [K] of motions [K, T, X] under controls [K, T, U] to a goal [2] in m."""
        spare = grid.at(states[..., 0], states[..., 1]) - self.margin
        speed = robot.speed(states)
        # Deep inside costs more than at the rim: a robot that is squeezed finds its way out.
        cost = self.collision * (spare < 0.0) * (1.0 - 4.0 * spare)
        lack = (1.0 - spare.clamp(min=0.0) / self.comfort).clamp(min=0.0)
        cost = cost + self.nearness * lack**2 * (0.3 + speed.abs())
        away = (states[..., :2] - goal).norm(dim=-1)
        cost = cost + self.distance * away
        cost = cost + self.effort * ((controls / robot.control_limit) ** 2).sum(-1)
        cost = cost + self.reversing * (-speed).clamp(min=0.0)
        return dt * cost.sum(-1) + self.terminal * away[:, -1]


def rollout(robot: Robot, state: Tensor, controls: Tensor, dt: float) -> Tensor:
    """States [M, T, X] from [X] under controls [M, T, U]."""
    current, states = state.expand(len(controls), -1), []
    for control in controls.unbind(1):
        current = robot.step(current, control, dt)
        states.append(current)
    return torch.stack(states, 1)
