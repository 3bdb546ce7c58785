"""A grid of clearances round the robot that torch interpolates for the controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from anchorflow_trajectory.cost.clearance import distance_to_cells


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
