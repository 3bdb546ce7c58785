"""Conditioning on a cost map: the map, its fields, state, goal and style of one scene."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import (
    OCCUPIED,
    AnchorRequest,
    CostMap,
    LimitsSpec,
    ResolvedRequest,
    WarmStart,
)
from anchorflow_client.contract.batch import NEAR
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.bundle.manifest import CostMapEntry, Manifest
from anchorflow_service.engine.parts import Arrays, unknown_names
from anchorflow_trajectory import clearance, geodesic
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.cost_fields import TRAVERSABILITY, CostFields

FloatArray = NDArray[np.float32]

REACH = 0.3
"""Way of the probe from start to goal, as a share of what v_max covers in the horizon."""
MARGIN = 2.0
"""Side of the probe's map, in such ways."""


class CostMapConditioning:
    """Scenes of maps; manifests may list what a scene names in SCENE_INPUTS."""

    def __init__(self, manifest: Manifest) -> None:
        assert isinstance(manifest.conditioning, CostMapEntry)
        self._manifest = manifest
        self._entry = manifest.conditioning

    def faults(self) -> Iterator[str]:
        """Inputs of encode that no scene has."""
        encode = self._manifest.graphs["encode"]
        yield from unknown_names("graphs.encode.inputs", encode.input_names, SCENE_INPUTS)

    def scenes(self, request: ResolvedRequest) -> list[MapScene]:
        """The scenes of a request, near the origin of their own frame.

        Raises:
            InvalidRequest: the map has more channels than the card's.
        """
        channels, most = request.cost_map.data.shape[1], self._entry.channels
        if channels > most:
            name = self._manifest.name
            raise InvalidRequest(
                f"expected C from 1 to {most}, the channels of {name}, got {channels}",
                "cost_map.data",
            )
        reference = _reference(request.cost_map)
        near = _moved(request, reference) if reference.any() else request
        return [MapScene(near, b, most, reference) for b in range(request.num_scenes)]

    def probe(self) -> AnchorRequest:
        """From one side of a free map to the other."""
        entry, dim = self._entry, self._manifest.D
        way = REACH * entry.limits.v_max * entry.limits.horizon_s  # m
        rest = np.zeros(2 * dim)
        start, goal = np.zeros(dim), np.zeros(dim)
        start[0], goal[0] = -way / 2, way / 2
        return AnchorRequest.build(
            cost_map={
                "data": np.zeros((1, entry.H, entry.W), np.float32),
                "resolution": MARGIN * way / min(entry.H, entry.W),
            },
            x_curr=[*start, *rest],
            x_goal=[*goal, *rest[:dim]],
            seed=0,
        )


@dataclass(frozen=True)
class MapScene:
    """One scene of a request, and the fields of its map, each worked out at most once.

    request: in a frame in which float32 resolves the map
    reference: [2] m, that frame's origin in the frame of the request as it came
    """

    request: ResolvedRequest
    index: int
    channels: int
    reference: NDArray[np.float64]

    @property
    def limits(self) -> LimitsSpec:
        """What the anchors keep."""
        assert self.request.limits is not None
        return self.request.limits

    @property
    def motion_limits(self) -> MotionLimits:
        """The same without the robot's radius."""
        limits = self.limits
        return MotionLimits(v_max=limits.v_max, a_max=limits.a_max, horizon_s=limits.horizon_s)

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
        return clearance.clearance_field(occupied, self.resolution, self.limits.robot_radius)

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

    def inputs(self, names: Iterable[str]) -> Arrays:
        """Those of SCENE_INPUTS that are named, with a B axis of 1."""
        return {name: getattr(self, name)[None] for name in names}

    def answered(self, arrays: Arrays) -> Arrays:
        """The same with trajectories back in the request's own frame, float64 where that is far."""
        if not self.reference.any():
            return arrays
        return arrays | {"trajectories": _displaced(arrays["trajectories"], self.reference)}


SCENE_INPUTS = (
    "cost_map",
    "map_geometry",
    "clearance_field",
    "cost_to_go",
    "x_curr",
    "x_goal",
    "w_style",
)


def _reference(cost_map: CostMap) -> NDArray[np.float64]:
    """[2] m: where a frame begins in which float32 resolves the map; its centre, where it is far.

    A map in UTM coordinates lies where float32 steps by half a metre.
    """
    extent = cost_map.extent
    return np.zeros(2) if np.abs(extent).max() <= NEAR else extent.mean(axis=0)


def _moved(request: ResolvedRequest, reference: NDArray[np.float64]) -> ResolvedRequest:
    """The request in a frame that begins at the reference."""
    scenes, warm = request.on_map, request.warm_start
    cost_map = replace(scenes.cost_map, origin=scenes.cost_map.origin - reference)
    moved = replace(
        scenes,
        cost_map=cost_map,
        x_curr=_displaced(scenes.x_curr, -reference),
        x_goal=_displaced(scenes.x_goal, -reference),
    )
    if warm is not None:
        warm = WarmStart(_displaced(warm.trajectory, -reference), warm.tau)
    return replace(request, map_scenes=moved, warm_start=warm)


def _displaced(vectors: NDArray[np.floating], by: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors [...,≥2] in float64 whose first two components, x and y in m, are moved."""
    moved = vectors.astype(np.float64)
    moved[..., :2] += by
    return moved
