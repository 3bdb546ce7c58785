"""The cost of motions: clearance and navigation cost along them, and cost to go from their ends.

Anchors reach beyond the controller's horizon, so the rest of the way is measured along them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from anchorflow_benchmarks.closed_loop.robots import Robot
from anchorflow_trajectory.cost.clearance import distance_to_cells

SPACING = 0.15  # m between the points kept of a path
MAX_POINTS = 48  # of a path
OFF_PATH_COST = 1.5  # m of way per metre away from the nearest point
BLOCKED_COST = 3.0  # m of way for an obstacle between a place and its path
SIGHT_POINTS = 6  # checked between a place and its path
MIN_SIGHT_CLEARANCE = -0.12  # m, below which the straight line meets an obstacle


@dataclass(frozen=True, eq=False)
class ClearanceGrid:
    """Clearances round the robot, interpolated by torch.

    values: [H*W] m beyond the robot's radius at cell centres; columns: W; origin: [2] m
    """

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
        surface: NDArray[np.floating] | None = None,
    ) -> ClearanceGrid:
        """Build the grid of a local map [H, W], whose edge is no obstacle.

        surface: [H, W, 2] m, the obstacle's place in each occupied cell; None for the whole cell
        """
        most = max(occupied.shape) * resolution
        if surface is None:
            outside = distance_to_cells(occupied, resolution)
        else:
            outside = _distance_to_places(occupied, surface, resolution, origin)
        outside = np.minimum(outside, most)
        inside = np.minimum(distance_to_cells(~occupied, resolution), most)
        values = torch.from_numpy((outside - inside - robot_radius).astype(np.float32))
        return ClearanceGrid(
            values.reshape(-1), occupied.shape[1], resolution, (float(origin[0]), float(origin[1]))
        )

    def at(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the m at points of any shape, bilinear; beyond the map as on its edge."""
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


def _distance_to_places(
    occupied: NDArray[np.bool_],
    places: NDArray[np.floating],
    resolution: float,
    origin: NDArray[np.floating],
) -> NDArray[np.floating]:
    """Return [H, W] m from cell centres to the place [H, W, 2] in the nearest occupied cell."""
    if not occupied.any():
        return np.full(occupied.shape, np.inf)
    indices = distance_transform_edt(~occupied, return_distances=False, return_indices=True)
    rows, columns = np.asarray(indices)
    y, x = (np.indices(occupied.shape) + 0.5) * resolution
    nearest = places[rows, columns]
    return np.hypot(x + origin[0] - nearest[..., 0], y + origin[1] - nearest[..., 1])


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
