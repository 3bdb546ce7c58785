"""Scenes to generate in: what a caller says of them, as the inputs of a model's encode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.generation.checks import batched, check
from anchorflow_trajectory.clearance import OCCUPIED, clearance_field
from anchorflow_trajectory.cost_fields import TRAVERSABILITY, CostFields
from anchorflow_trajectory.geodesic import cost_to_go

FloatArray = NDArray[np.float32]
Numbers = ArrayLike | Tensor

DEFAULT_STYLE = (0.4, 0.3, 0.3)
DEFAULT_RESOLUTION = 0.1  # m/cell
DEFAULT_ROBOT_RADIUS = 0.25  # m


@dataclass(frozen=True, eq=False)
class Scenes:
    """B scenes in SI and the map's frame.

    cost_map: [B, C, H, W] in [0, 1]
    clearance: [B, H, W] m beyond the robot's radius
    cost_to_go: [B, 2, H, W] m, from the start and to the goal
    x_curr: [B, 3D]; x_goal: [B, 2D]; w_style: [B, 3], sums to 1
    resolution: m/cell; origin: [B, 2] m, outer corner of cell (0, 0)
    """

    cost_map: FloatArray
    clearance: FloatArray
    cost_to_go: FloatArray
    x_curr: FloatArray
    x_goal: FloatArray
    w_style: FloatArray
    resolution: float
    origin: NDArray[np.float64]

    @staticmethod
    def of(
        cost_map: Numbers,
        x_curr: Numbers,
        x_goal: Numbers,
        w_style: Numbers | None = None,
        *,
        config: L2Config,
        resolution: float = DEFAULT_RESOLUTION,
        origin: ArrayLike | None = None,
        robot_radius: float = DEFAULT_ROBOT_RADIUS,
    ) -> Scenes:
        """Scenes from arrays or tensors; one without a B axis is the same in every scene.

        cost_map: [C, H, W], C up to the model's; channels left out are neutral
        x_curr: [3D]; x_goal: [2D]; w_style: [3], scaled to sum to 1, (0.4, 0.3, 0.3) by default
        origin: [2] m; by default the map's centre is (0, 0)

        Raises:
            ValueError: a field is not that; the message names it.
        """
        maps = _cost_map(cost_map, config.map_channels)
        start = batched("x_curr", x_curr, f"[{3 * config.dim}]", (3 * config.dim,))
        goal = batched("x_goal", x_goal, f"[{2 * config.dim}]", (2 * config.dim,))
        style = _style(DEFAULT_STYLE if w_style is None else w_style)
        check("resolution", resolution > 0, "m/cell above 0", resolution)
        check("robot_radius", robot_radius >= 0, "0 m or more", robot_radius)
        corner = _origin(origin, maps.shape[2:], resolution)
        named = {"cost_map": maps, "x_curr": start, "x_goal": goal, "w_style": style}
        maps, start, goal, style, corner = _broadcast({**named, "origin": corner})
        for name, ends in (("x_curr", start), ("x_goal", goal)):
            _check_ends(name, ends[:, :2], maps[:, 0], corner, resolution)
        clearance, ways = _fields(maps, start, goal, corner, resolution, robot_radius)
        return Scenes(maps, clearance, ways, start, goal, style, resolution, corner)

    def __len__(self) -> int:
        return len(self.cost_map)

    def encode_inputs(self, device: torch.device) -> Mapping[str, Tensor]:
        """The inputs of a model's encode, by name."""
        resolution = np.full((len(self), 1), self.resolution)
        inputs = {
            "cost_map": self.cost_map,
            "map_geometry": np.concatenate([self.origin, resolution], 1, dtype=np.float32),
            "clearance_field": self.clearance,
            "cost_to_go": self.cost_to_go,
            "x_curr": self.x_curr,
            "x_goal": self.x_goal,
            "w_style": self.w_style,
        }
        return {name: torch.tensor(array, device=device) for name, array in inputs.items()}

    def cost_fields(self, scene: int) -> CostFields:
        """One scene as the finish looks it up."""
        origin = self.origin[scene]
        return CostFields.of(self.cost_map[scene], self.clearance[scene], self.resolution, origin)


def _cost_map(value: Numbers, channels: int) -> FloatArray:
    """[B, C, H, W] with all the model's channels: 1 for traversability, else 0, where left out."""
    given = batched("cost_map", value, "[C, H, W]", (None, None, None))
    count = given.shape[1]
    check("cost_map", 1 <= count <= channels, f"C from 1 to {channels}, the model's", count)
    inside = given.min() >= 0 and given.max() <= 1
    check("cost_map", inside, "values in [0, 1]", f"{given.min():g} to {given.max():g}")
    maps = np.zeros((len(given), channels, *given.shape[2:]), np.float32)
    maps[:, TRAVERSABILITY : TRAVERSABILITY + 1] = 1.0
    maps[:, :count] = given
    return maps


def _style(value: Numbers) -> FloatArray:
    style = batched("w_style", value, "[3]", (3,))
    total = style.sum(-1, keepdims=True)
    check("w_style", (style >= 0).all() and total.all(), "weights >= 0, not all 0", style.tolist())
    return style / total


def _origin(
    value: ArrayLike | None, shape: tuple[int, ...], resolution: float
) -> NDArray[np.float64]:
    """[B, 2] in float64: maps may lie far from the frame's origin."""
    if value is None:
        return -0.5 * resolution * np.array([shape[::-1]], np.float64)
    origin = np.atleast_2d(np.asarray(value, np.float64))
    check("origin", origin.ndim == 2 and origin.shape[1] == 2, "[2] or [B, 2]", origin.shape)
    check("origin", np.isfinite(origin).all(), "finite numbers", origin.tolist())
    return origin


def _broadcast(arrays: Mapping[str, NDArray]) -> list[NDArray]:
    """All with the B of the largest."""
    count = max(map(len, arrays.values()))
    for name, array in arrays.items():
        check(name, len(array) in (1, count), f"B of 1 or {count}", len(array))
    return [np.broadcast_to(array, (count, *array.shape[1:])) for array in arrays.values()]


def _check_ends(
    name: str, points: FloatArray, occupancy: FloatArray, origin: NDArray, resolution: float
) -> None:
    """ValueError unless points [B, 2] lie in free cells of occupancy [B, H, W]."""
    height, width = occupancy.shape[1:]
    cells = np.floor((points - origin) / resolution).astype(int)
    inside = ((cells >= 0) & (cells < (width, height))).all()
    extent = f"{width * resolution:g} x {height * resolution:g} m from {origin[0].tolist()}"
    check(name, inside, f"a point on the map, {extent}", points.tolist())
    column, row = cells.T
    free = (occupancy[np.arange(len(occupancy)), row, column] < OCCUPIED).all()
    check(name, free, "a cell that is not occupied", points.tolist())


def _fields(
    maps: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    origin: NDArray[np.float64],
    resolution: float,
    robot_radius: float,
) -> tuple[FloatArray, FloatArray]:
    """Clearance [B, H, W] and cost to go [B, 2, H, W], each in m."""
    rooms, ways = [], []
    for cost_map, *ends, corner in zip(maps, start, goal, origin, strict=True):
        rooms.append(clearance_field(cost_map[0] >= OCCUPIED, resolution, robot_radius))
        points = (end[:2] for end in ends)
        ways.append(cost_to_go(rooms[-1], resolution, corner, *points))
    return np.stack(rooms).astype(np.float32), np.stack(ways).astype(np.float32)
