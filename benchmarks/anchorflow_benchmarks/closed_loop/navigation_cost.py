"""What a motion costs: the same for every sample and every contender."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from anchorflow_benchmarks.closed_loop.clearance_grid import ClearanceGrid
from anchorflow_benchmarks.closed_loop.robots import Robot
from anchorflow_benchmarks.closed_loop.ways_left import WaysLeft


@dataclass(frozen=True)
class NavigationCost:
    """J = sum_t dt (collision + nearness + distance + effort + reversing) + terminal way left.

    margin: m of clearance below which a state counts as a collision; what requests have certified
    comfort: m of clearance, beyond the margin, from which more is worth nothing
    """

    margin: float = 0.03
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
        ways: WaysLeft | None = None,
    ) -> Tensor:
        """J [K] of motions [K, T, X] under controls [K, T, U] to a goal [2] in m.

        ways: by which the way that is left at the end is told; None: as the crow flies
        """
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
        left = away[:, -1] if ways is None else ways.left_from(states[:, -1, :2], grid)
        return dt * cost.sum(-1) + self.terminal * left


def rollout(robot: Robot, state: Tensor, controls: Tensor, dt: float) -> Tensor:
    """States [M, T, X] from [X] under controls [M, T, U]."""
    current, states = state.expand(len(controls), -1), []
    for control in controls.unbind(1):
        current = robot.step(current, control, dt)
        states.append(current)
    return torch.stack(states, 1)
