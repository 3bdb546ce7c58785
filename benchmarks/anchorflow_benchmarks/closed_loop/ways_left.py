"""What anchors tell beyond a controller's own horizon: how long the way to the goal still is."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from anchorflow_benchmarks.closed_loop.clearance_grid import ClearanceGrid

SPACING = 0.15  # m between the points of a way, at most as many as POINTS
POINTS = 48
ASIDE = 1.5  # m of way that a metre away from the nearest point counts
BLOCKED = 3.0  # m that an obstacle between a place and its way counts
LOOKS = 6  # between a place and its way
ROOM = -0.12  # m of clearance below which the straight line between them meets an obstacle


@dataclass(frozen=True, eq=False)
class WaysLeft:
    """points: [P, 2] m, along ways; left: [P] m, from each to the goal, with its handicap."""

    points: Tensor
    left: Tensor

    @staticmethod
    def along(paths: Tensor, goal: Tensor, handicap: Tensor) -> WaysLeft:
        """Of paths [M, S, 2] in m, which end at the goal [2] or on the way to it.

        handicap: [M] m, by which a way counts as longer than it is
        """
        lengths = torch.zeros(paths.shape[:2])
        lengths[:, 1:] = torch.diff(paths, dim=1).norm(dim=-1).cumsum(1)
        beyond = (goal - paths[:, -1]).norm(dim=-1)
        count = int(min(POINTS, max(2.0, float(lengths[:, -1].max()) / SPACING)))
        # Samples at equal steps of way: those that stand still at the end tell nothing more.
        wanted = torch.linspace(0.0, 1.0, count) * lengths[:, -1:]
        index = torch.searchsorted(lengths, wanted).clamp(max=paths.shape[1] - 1)
        rows = torch.arange(len(paths))[:, None]
        left = lengths[:, -1:] - lengths[rows, index] + (beyond + handicap)[:, None]
        return WaysLeft(paths[rows, index].reshape(-1, 2), left.reshape(-1))

    def left_from(self, places: Tensor, grid: ClearanceGrid) -> Tensor:
        """m [K] from places [K, 2] in m: to a point of a way, and along it.

        A point behind an obstacle is further than it looks.
        """
        left, nearest = (ASIDE * torch.cdist(places, self.points) + self.left).min(1)
        share = torch.linspace(0.0, 1.0, LOOKS)[:, None, None]
        between = places + share * (self.points[nearest] - places)
        room = grid.at(between[..., 0], between[..., 1]).amin(0)
        return left + BLOCKED * (room < ROOM)


def clear_ways(paths: Tensor, grid: ClearanceGrid, margin: float) -> Tensor:
    """[M], whether paths [M, S, 2] keep the margin in m, or what the robot has where it stands."""
    room = grid.at(paths[..., 0], paths[..., 1])
    return room.amin(1) >= torch.clamp(room[:, 0], max=margin)
