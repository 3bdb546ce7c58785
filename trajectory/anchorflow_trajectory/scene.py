"""A scene: one planning problem, and the fields that follow from its map."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import clearance, geodesic
from anchorflow_trajectory.cost_fields import TRAVERSABILITY, CostFields

FloatArray = NDArray[np.floating]

SCENE_INPUTS = (
    "cost_map",
    "map_geometry",
    "clearance_field",
    "cost_to_go",
    "x_curr",
    "x_goal",
    "w_style",
)
"""What a network may be told of a scene, by the names of `Scene.inputs`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """One planning problem in SI and its map's frame; each field is worked out at most once.

    cost_map: float32 [C, H, W] in [0, 1]: occupancy, traversability, risk, further semantics
    resolution: m/cell; origin: float64 [2] m, outer corner of cell (0, 0); robot_radius: m
    x_curr: [3D] p, v, a in m, m/s, m/s^2; x_goal: [2D] p, v; D = 3 adds a heading in rad
    w_style: [3] weights of safety, energy and smoothness, which sum to 1
    """

    cost_map: NDArray[np.float32]
    resolution: float
    origin: NDArray[np.float64]
    robot_radius: float
    x_curr: FloatArray
    x_goal: FloatArray
    w_style: FloatArray

    @cached_property
    def occupied(self) -> NDArray[np.bool_]:
        """[H, W], the cells of obstacles."""
        return self.cost_map[0] >= clearance.OCCUPIED

    @cached_property
    def clearance_field(self) -> NDArray[np.float32]:
        """[H, W] m beyond robot_radius at cell centres, negative inside obstacles."""
        return clearance.clearance_field(self.occupied, self.resolution, self.robot_radius)

    @cached_property
    def cost_to_go(self) -> NDArray[np.float32]:
        """[2, H, W] m, geodesic cost from the start and to the goal, whatever their headings."""
        start, goal = self.x_curr[:2], self.x_goal[:2]
        return geodesic.cost_to_go(self.clearance_field, self.resolution, self.origin, start, goal)

    @cached_property
    def cost_fields(self) -> CostFields:
        """The maps as the cost of a trajectory looks them up."""
        return CostFields.of(self.cost_map, self.clearance_field, self.resolution, self.origin)

    @property
    def map_geometry(self) -> NDArray[np.float32]:
        """[3]: origin x and y [m], resolution [m/cell]."""
        return np.array([*self.origin, self.resolution], np.float32)

    def inputs(self, names: Iterable[str]) -> dict[str, NDArray[np.float32]]:
        """The arrays of these names, out of SCENE_INPUTS, in float32 and with a B axis of 1."""
        return {name: np.asarray(getattr(self, name), np.float32)[None] for name in names}

    def is_free(self, point: FloatArray) -> bool:
        """Whether a point [2] m lies on the map, its border included, in no obstacle's cell."""
        upper = self.origin + self.resolution * np.array(self.occupied.shape[::-1])
        if not ((point >= self.origin) & (point <= upper)).all():
            return False
        cell = geodesic.cell_index(point, self.origin, self.resolution, self.occupied.shape)
        return not self.occupied.flat[cell]


def with_neutral_channels(cost_map: FloatArray, channels: int) -> NDArray[np.float32]:
    """A map [C, H, W] with as many channels at least; what is left out is neutral.

    Ground that nobody described is easy to pass and without risk: traversability 1, the others 0.
    """
    filled = np.zeros((max(channels, len(cost_map)), *cost_map.shape[1:]), np.float32)
    filled[TRAVERSABILITY : TRAVERSABILITY + 1] = 1.0
    filled[: len(cost_map)] = cost_map
    return filled
