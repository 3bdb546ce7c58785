"""Conditioning on a cost map: the map, its fields, state, goal and style of one scene."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import (
    AnchorRequest,
    CostMap,
    LimitsSpec,
    Obstacles,
    ResolvedRequest,
)
from anchorflow_client.contract.batch import NEAR
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.bundle.entries import SplineEntry
from anchorflow_service.bundle.manifest import RAW_POSITIONS, CostMapSpec, Manifest
from anchorflow_service.engine.interfaces import Arrays, unknown_names
from anchorflow_service.engine.later_loops import MOVING_LOOPS, POSE_LOOPS
from anchorflow_trajectory.bodies.outline import Outline, covered
from anchorflow_trajectory.cost.clearance import FINE, FINE_AMONG, OCCUPIED, finer_cells
from anchorflow_trajectory.ending import among_movers, ending_at
from anchorflow_trajectory.finish.certificate import required_clearance
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.movers import MovingDiscs
from anchorflow_trajectory.routes.passing import MOST_ASIDE
from anchorflow_trajectory.routes.reachable import cells_under, nearest_reachable
from anchorflow_trajectory.routes.search import SLACK
from anchorflow_trajectory.scene import NETWORK_CHANNELS, SCENE_INPUTS, Scene
from anchorflow_trajectory.spline.basis import SplineBasis, spline_basis

REACH = 2.0
"""Way of the probe from start to goal, in s at v_max."""
MARGIN = 2.0
"""Side of the probe's map, in such ways."""
ROOM = 0.15
"""m beyond the needed clearance that a goal gets which has to move."""
DIGITS = 8
"""Decimal digits kept of a position in m that is far from zero."""


class CostMapConditioning:
    """Reads scenes of maps; a scene provides the inputs that SCENE_INPUTS names."""

    def __init__(self, manifest: Manifest) -> None:
        assert isinstance(manifest.conditioning, CostMapSpec)
        self._manifest = manifest
        self._entry = manifest.conditioning
        self._basis = _basis_of(manifest)

    def faults(self) -> Iterator[str]:
        if (channels := self._entry.channels) != NETWORK_CHANNELS:
            names = "obstacles, traversability and risk"
            yield f"conditioning.channels: expected {NETWORK_CHANNELS}, {names}, found {channels}"
        encode = self._manifest.graphs["encode"]
        yield from unknown_names("graphs.encode.inputs", encode.input_names, SCENE_INPUTS)

    def scenes(self, request: ResolvedRequest) -> list[MapScene]:
        """Return the scenes of a request, near the origin of their own frame.

        Raises `InvalidRequest` if no goal within its tolerance can be reached, and `NotReady`.
        """
        if request.obstacles is not None:
            MOVING_LOOPS.require()
        if request.has_body:
            POSE_LOOPS.require()
        reference = _reference(request.cost_map)
        near = _moved(request, reference) if reference.any() else request
        movers = moving_discs(near.obstacles)
        scenes = [self._scene(near, index, movers) for index in range(request.num_scenes)]
        if request.has_body:  # its goal and what moves are matters of its outline
            return [MapScene(near, scene, reference) for scene in scenes]
        tolerance = None if movers is None else MOST_ASIDE
        if request.goal_tolerance is not None:
            tolerance = request.goal_tolerance.position
        if tolerance is not None:
            for index, scene in enumerate(scenes):
                moved = _within_tolerance(scene, tolerance)
                if moved is None:
                    place = "({:g}, {:g}) m".format(*request.x_goal[index, :2])
                    raise InvalidRequest(
                        f"expected a goal within {tolerance:g} m of a place that can be "
                        f"reached, got {place} of scene {index}",
                        "x_goal",
                    )
                scenes[index] = moved
        return [MapScene(near, among_movers(scene), reference) for scene in scenes]

    def _scene(self, request: ResolvedRequest, index: int, movers: MovingDiscs | None) -> Scene:
        cost_map, limits = request.cost_map, _limits(request)
        cells = cost_map.data[index]
        among = not (movers is None or request.has_body) and (cells[0] >= OCCUPIED).any()
        fine = FINE_AMONG if among else FINE
        cells, resolution = finer_cells(cells, cost_map.resolution, fine)
        start, radius = request.x_curr[index], limits.robot_radius
        outline = outline_of(request) if request.has_body else None
        if request.clear_start:
            cells, (height, width) = cells.copy(), cells.shape[1:]
            grid: Any = {"resolution": resolution, "origin": cost_map.origin}
            grid["shape"] = (height, width)
            if outline is None:
                cells[0, cells_under(start[:2], radius, **grid)] = 0.0
            else:
                cells[0, covered(outline, start[:3], **grid)] = 0.0
        return Scene(
            cost_map=cells,
            resolution=resolution,
            origin=cost_map.origin,
            robot_radius=radius if outline is None else outline.inner,
            x_curr=start,
            x_goal=request.x_goal[index],
            w_style=request.w_style[index],
            motion=MotionLimits(limits.v_max, limits.a_max, limits.horizon_s),
            basis=self._basis,
            certified_margin=request.certified_margin,
            cost_penalty=request.cost_penalty,
            channel_weights=cost_map.channel_weights,
            movers=movers,
        )

    def probe(self) -> AnchorRequest:
        """Return a request from one side of a free map to the other."""
        entry, dim = self._entry, self._manifest.D
        way = REACH * entry.limits.v_max  # m
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
    """One scene of a request.

    request: in a frame in which float32 resolves the map
    scene: what the request says of it, in that frame
    reference: [2] m, that frame's origin in the frame of the request as it came
    """

    request: ResolvedRequest
    scene: Scene
    reference: NDArray[np.float64]

    @property
    def limits(self) -> LimitsSpec:
        return _limits(self.request)

    def inputs(self, names: Iterable[str]) -> Arrays:
        return self.scene.inputs(names)

    def answered(self, arrays: Arrays) -> Arrays:
        """Return the arrays with trajectories in the request's own frame, float64 if it is far."""
        if not self.reference.any():
            return arrays
        placed = [name for name in ("trajectories", RAW_POSITIONS) if name in arrays]
        return arrays | {name: _displaced(arrays[name], self.reference) for name in placed}


def outline_of(request: ResolvedRequest) -> Outline:
    """Return the footprint of a request, or a polygon about its disc."""
    if request.footprint is not None:
        return _outline_with(np.asarray(request.footprint, np.float64).tobytes())
    assert request.limits is not None  # a request for poses is on a map
    return Outline.disc(request.limits.robot_radius)


@lru_cache(maxsize=64)
def _outline_with(corners: bytes) -> Outline:
    """Return the outline with corners [K, 2]; a robot's is the same in all of its requests."""
    return Outline(np.frombuffer(corners, np.float64).reshape(-1, 2).copy())


def moving_discs(obstacles: Obstacles | None) -> MovingDiscs | None:
    """Return the obstacles of a request as discs of their own radius; None if there are none."""
    if obstacles is None:
        return None
    return MovingDiscs.of(
        obstacles.position,
        obstacles.velocity,
        obstacles.radius,
        forecast=obstacles.forecast,
        forecast_dt=obstacles.forecast_dt,
        growth=obstacles.growth,
    )


def _basis_of(manifest: Manifest) -> SplineBasis:
    """Return the splines of the finish, which routes use too."""
    entry, steps = manifest.finish, manifest.time.steps
    if not isinstance(entry, SplineEntry):
        return spline_basis(steps)
    return spline_basis(steps, num_control_points=entry.num_control_points, degree=entry.degree)


def _within_tolerance(scene: Scene, tolerance: float) -> Scene | None:
    """Return the scene with the nearest goal that can be reached; None if it has none.

    A free goal that cannot be reached stays if nothing near it can be: no anchor will be safe.
    """
    goal, field = scene.x_goal[:2], scene.cost_fields.clearance
    is_free = scene.is_free(goal)
    needed = required_clearance(field, scene.certified_margin)
    if is_free and field.sample(*goal.astype(np.float32)) >= needed and scene.routes:
        return scene
    for slack in (needed + ROOM, needed, SLACK):
        place = nearest_reachable(
            scene.clearance_field,
            resolution=scene.resolution,
            origin=scene.origin,
            start=scene.x_curr[:2],
            goal=goal,
            within=tolerance,
            slack=slack,
        )
        if place is not None:
            return ending_at(scene, place)
    return scene if is_free else None


def _limits(request: ResolvedRequest) -> LimitsSpec:
    assert request.limits is not None  # a card with a cost map has them
    return request.limits


def _reference(cost_map: CostMap) -> NDArray[np.float64]:
    """Return [2] m: the origin of a frame in which float32 resolves the map; zero if it is near.

    In UTM coordinates float32 steps by half a metre. The frame begins at the map's centre or at its
    corner, whichever is the rounder number, because callers choose their own zero that way. A map
    centred on that zero has the same answer as near home; any other is planned in another frame,
    whose rounding moves some of the anchors.
    """
    corner, opposite = extent = cost_map.extent
    if np.abs(extent).max() <= NEAR:
        return np.zeros(2)
    return min(np.round([0.5 * (corner + opposite), corner], 3), key=_decimals)


def _decimals(numbers: NDArray[np.float64]) -> int:
    """Return the decimal digits of numbers that have three at most."""
    return next(k for k in range(4) if np.array_equal(np.round(numbers, k), numbers))


def _moved(request: ResolvedRequest, reference: NDArray[np.float64]) -> ResolvedRequest:
    """Return the request in a frame that begins at the reference."""
    scenes, warm, obstacles = request.on_map, request.warm_start, request.obstacles
    cost_map = replace(scenes.cost_map, origin=_near(scenes.cost_map.origin, reference))
    moved = replace(
        scenes,
        cost_map=cost_map,
        x_curr=_near(scenes.x_curr, reference),
        x_goal=_near(scenes.x_goal, reference),
    )
    if warm is not None:
        warm = replace(warm, trajectory=_near(warm.trajectory, reference))
    if obstacles is not None:
        forecast = obstacles.forecast
        obstacles = replace(
            obstacles,
            position=_near(obstacles.position, reference),
            forecast=None if forecast is None else _near(forecast, reference),
        )
    return replace(request, map_scenes=moved, warm_start=warm, obstacles=obstacles)


def _near(vectors: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors in the reference's frame, without the digits that distance has rounded off.

    A double steps by a nanometre at 5,000 km: a point on the border of two cells would move into
    one of them, and start another search.
    """
    moved = _displaced(vectors, -reference)
    moved[..., :2] = np.round(moved[..., :2], DIGITS) + 0.0  # no negative zero
    return moved


def _displaced(vectors: NDArray[np.floating], by: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move the first two components, x and y in m, of vectors [...,≥2]; return float64."""
    moved = vectors.astype(np.float64)
    moved[..., :2] += by
    return moved
