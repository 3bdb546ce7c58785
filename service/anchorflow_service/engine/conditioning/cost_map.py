"""Conditioning: what a request says of one scene, as the named inputs of an encode graph."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OCCUPIED, ModelCard, ResolvedRequest, TensorSpec
from anchorflow_client.errors import InvalidRequest
from anchorflow_trajectory import clearance, geodesic
from anchorflow_trajectory.cost_fields import TRAVERSABILITY, CostFields

FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class Scene:
    """One scene of a request, and the fields of its map, each worked out at most once.

    Its properties named in SCENE_INPUTS are what a manifest may list as inputs, without the B axis.
    """

    request: ResolvedRequest
    index: int
    channels: int

    @property
    def resolution(self) -> float:
        """m/cell."""
        return self.request.cost_map.resolution

    @property
    def origin(self) -> NDArray[np.float64]:
        """[2] m, outer corner of cell (0, 0)."""
        return self.request.cost_map.origin

    @cached_property
    def cost_map(self) -> FloatArray:
        """[C,H,W] in [0, 1]; channels left out are neutral: 1 for traversability, else 0."""
        given = self.request.cost_map.data[self.index]
        cost_map = np.zeros((self.channels, *given.shape[1:]), np.float32)
        cost_map[TRAVERSABILITY : TRAVERSABILITY + 1] = 1.0
        cost_map[: len(given)] = given
        return cost_map

    @property
    def map_geometry(self) -> FloatArray:
        """[3]: origin x and y [m], resolution [m/cell]."""
        return np.array([*self.origin, self.resolution], np.float32)

    @cached_property
    def clearance_field(self) -> FloatArray:
        """[H,W] m beyond robot_radius at cell centres, negative inside obstacles."""
        occupied = self.request.cost_map.occupancy[self.index] >= OCCUPIED
        return clearance.clearance_field(occupied, self.resolution, self.request.robot_radius)

    @cached_property
    def cost_to_go(self) -> FloatArray:
        """[2,H,W] m, geodesic cost from the start and to the goal, whatever their headings."""
        start, goal = self.request.x_curr[self.index, :2], self.request.x_goal[self.index, :2]
        return geodesic.cost_to_go(self.clearance_field, self.resolution, self.origin, start, goal)

    @property
    def x_curr(self) -> FloatArray:
        """[3D] p, v, a in m, m/s, m/s²; a heading in rad, rad/s, rad/s²."""
        return self.request.x_curr[self.index].astype(np.float32)

    @property
    def x_goal(self) -> FloatArray:
        """[2D] p, v."""
        return self.request.x_goal[self.index].astype(np.float32)

    @property
    def w_style(self) -> FloatArray:
        """[3] weights of safety, energy and smoothness; they sum to 1."""
        return self.request.w_style[self.index].astype(np.float32)

    @cached_property
    def cost_fields(self) -> CostFields:
        """The maps as the finish looks them up."""
        return CostFields.of(self.cost_map, self.clearance_field, self.resolution, self.origin)

    def inputs(self, specs: Iterable[TensorSpec]) -> dict[str, FloatArray]:
        """The inputs that a manifest lists, by name and with a B axis of 1."""
        return {spec.name: getattr(self, spec.name)[None] for spec in specs}


SCENE_INPUTS = (
    "cost_map",
    "map_geometry",
    "clearance_field",
    "cost_to_go",
    "x_curr",
    "x_goal",
    "w_style",
)


def scenes_of(request: ResolvedRequest, card: ModelCard) -> list[Scene]:
    """The scenes of a request.

    Raises:
        InvalidRequest: the map has more channels than the card's.
    """
    channels = request.cost_map.data.shape[1]
    if channels > card.map.channels:
        raise InvalidRequest(
            f"expected C from 1 to {card.map.channels}, the channels of {card.name}, "
            f"got {channels}",
            "cost_map.data",
        )
    return [Scene(request, b, card.map.channels) for b in range(request.num_scenes)]
