"""The cost of motions: navigation cost along them, and cost to go from where they end.

Anchors reach beyond the controller's horizon, so the rest of the way is measured along them.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from anchorflow_benchmarks.closed_loop.clearance_grid import ClearanceGrid
from anchorflow_benchmarks.closed_loop.robots import Robot

SPACING = 0.15  # m between the points kept of a path
MAX_POINTS = 48  # of a path
OFF_PATH_COST = 1.5  # m of way per metre away from the nearest point
BLOCKED_COST = 3.0  # m of way for an obstacle between a place and its path
SIGHT_POINTS = 6  # checked between a place and its path
MIN_SIGHT_CLEARANCE = -0.12  # m, below which the straight line meets an obstacle


@dataclass(frozen=True, eq=False)
class CostToGo:
    """points: [P, 2] m, on paths; left: [P] m from each to the goal, with the path's handicap."""

    points: Tensor
    left: Tensor

    @staticmethod
    def along(paths: Tensor, goal: Tensor, handicap: Tensor) -> CostToGo:
        """Build it from paths [M, S, 2] in m, which end at the goal [2] or before it.

        handicap: [M] m added to the length of each path
        """
        lengths = torch.zeros(paths.shape[:2])
        lengths[:, 1:] = torch.diff(paths, dim=1).norm(dim=-1).cumsum(1)
        beyond = (goal - paths[:, -1]).norm(dim=-1)
        count = int(min(MAX_POINTS, max(2.0, float(lengths[:, -1].max()) / SPACING)))
        # Samples at equal distances; those that stand still at the end add nothing.
        wanted = torch.linspace(0.0, 1.0, count) * lengths[:, -1:]
        index = torch.searchsorted(lengths, wanted).clamp(max=paths.shape[1] - 1)
        rows = torch.arange(len(paths))[:, None]
        left = lengths[:, -1:] - lengths[rows, index] + (beyond + handicap)[:, None]
        return CostToGo(paths[rows, index].reshape(-1, 2), left.reshape(-1))

    def left_from(self, places: Tensor, grid: ClearanceGrid) -> Tensor:
        """Return the m [K] from places [K, 2] in m to a point of a path and along it.

        An obstacle on the straight line to the point adds BLOCKED_COST.
        """
        left, nearest = (OFF_PATH_COST * torch.cdist(places, self.points) + self.left).min(1)
        share = torch.linspace(0.0, 1.0, SIGHT_POINTS)[:, None, None]
        between = places + share * (self.points[nearest] - places)
        room = grid.at(between[..., 0], between[..., 1]).amin(0)
        return left + BLOCKED_COST * (room < MIN_SIGHT_CLEARANCE)


def clear_paths(paths: Tensor, grid: ClearanceGrid, margin: float) -> Tensor:
    """Check [M] that paths [M, S, 2] keep the margin in m, or the clearance at their start."""
    room = grid.at(paths[..., 0], paths[..., 1])
    return room.amin(1) >= torch.clamp(room[:, 0], max=margin)


@dataclass(frozen=True)
class NavigationCost:
    """J = sum_t dt (collision + nearness + distance + effort + reversing) + terminal way left.

    margin: m of clearance below which a state counts as a collision; also certified by requests
    comfort: m of clearance beyond the margin, above which nearness costs nothing
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
        to_go: CostToGo | None = None,
    ) -> Tensor:
        """Return J [K] of motions [K, T, X] under controls [K, T, U] to a goal [2] in m.

        to_go: measures the way left at the end; None for the straight line
        """
        spare = grid.at(states[..., 0], states[..., 1]) - self.margin
        speed = robot.speed(states)
        # Deeper inside an obstacle costs more, so that a squeezed robot finds its way out.
        cost = self.collision * (spare < 0.0) * (1.0 - 4.0 * spare)
        lack = (1.0 - spare.clamp(min=0.0) / self.comfort).clamp(min=0.0)
        cost = cost + self.nearness * lack**2 * (0.3 + speed.abs())
        away = (states[..., :2] - goal).norm(dim=-1)
        cost = cost + self.distance * away
        cost = cost + self.effort * ((controls / robot.control_limit) ** 2).sum(-1)
        cost = cost + self.reversing * (-speed).clamp(min=0.0)
        left = away[:, -1] if to_go is None else to_go.left_from(states[:, -1, :2], grid)
        return dt * cost.sum(-1) + self.terminal * left


def rollout(robot: Robot, state: Tensor, controls: Tensor, dt: float) -> Tensor:
    """Return the states [M, T, X] from [X] under controls [M, T, U]."""
    current, states = state.expand(len(controls), -1), []
    for control in controls.unbind(1):
        current = robot.step(current, control, dt)
        states.append(current)
    return torch.stack(states, 1)
