"""A scene: one planning problem, and the fields that follow from its map."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.caching import cached_property
from anchorflow_trajectory.cost import clearance
from anchorflow_trajectory.cost.fields import TRAVERSABILITY, CostFields
from anchorflow_trajectory.cost.trajectory_cost import CostWeights
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.routes.dijkstra import cell_index
from anchorflow_trajectory.routes.homotopy import ObstacleRays
from anchorflow_trajectory.routes.search import SLACK, Route, find_routes
from anchorflow_trajectory.routes.shortening import CHORD_SLACK, pulled_tight
from anchorflow_trajectory.routes.splines import LEAST_WAY, splines_along
from anchorflow_trajectory.spline.basis import DEGREE, Ends, SplineBasis, Splines, spline_basis

ROUTE_STATES = "route_states"
SCENE_INPUTS = (
    "cost_map",
    "map_geometry",
    "clearance_field",
    "x_curr",
    "x_goal",
    "w_style",
    "limits",
    ROUTE_STATES,
)
"""The possible inputs of a network, as names for `Scene.inputs`."""
NUM_STEPS = 64
LONGEST_STRETCH = 3.0  # of the reference time, that anchors last as a rule
FIRST_GAIN = 0.2  # of an acceleration's effect in one span is what shows before it is taken back
TOP_SPEED = 0.97  # share of v_max


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """One planning problem in SI and its map's frame; derived fields are cached.

    cost_map: float32 [C, H, W] in [0, 1]: occupancy, traversability, risk, further semantics
    resolution: m/cell; origin: float64 [2] m, outer corner of cell (0, 0); robot_radius: m
    x_curr: [3D] p, v, a in m, m/s, m/s^2; x_goal: [2D] p, v; D = 3 adds a heading in rad
    w_style: [3] weights of safety, energy and smoothness, which sum to 1
    motion: what anchors keep
    basis: of the splines along the routes
    certified_margin: m beyond robot_radius that routes keep, where any can
    cost_penalty: m of detour that 1 m through soft cost 1 is worth
    channel_weights: [C-1] factors of the soft costs of channels 1 to C - 1; None: 1 each
    """

    cost_map: NDArray[np.float32]
    resolution: float
    origin: NDArray[np.float64]
    robot_radius: float
    x_curr: FloatArray
    x_goal: FloatArray
    w_style: FloatArray
    motion: MotionLimits
    basis: SplineBasis = field(default_factory=lambda: spline_basis(NUM_STEPS))
    certified_margin: float = 0.0
    cost_penalty: float = 3.0
    channel_weights: NDArray[np.float32] | None = None

    @cached_property
    def occupied(self) -> NDArray[np.bool_]:
        """[H, W], the cells of obstacles."""
        return self.cost_map[0] >= clearance.OCCUPIED

    @cached_property
    def clearance_field(self) -> NDArray[np.float32]:
        """[H, W] m beyond robot_radius at cell centres, negative inside obstacles."""
        return clearance.clearance_field(self.occupied, self.resolution, self.robot_radius)

    @cached_property
    def ends(self) -> Ends:
        """Return the end states of every anchor, with the start's acceleration eased if necessary.

        A spline cannot revert an acceleration before its next knot; one that would exceed the speed
        limit by then is scaled down.
        """
        dim = len(self.x_goal) // 2
        velocity, acceleration = self.x_curr[dim : dim + 2], self.x_curr[2 * dim : 2 * dim + 2]
        if not acceleration.any():
            return Ends(self.x_curr, self.x_goal)
        lasting = self.motion.horizon_s or LONGEST_STRETCH * self.reference_s
        gained = acceleration * (FIRST_GAIN * lasting / (self.basis.num_control_points - DEGREE))
        most = max(TOP_SPEED * self.motion.v_max, float(np.linalg.norm(velocity)))
        share = share_within(velocity, gained, most)
        if share == 1.0:
            return Ends(self.x_curr, self.x_goal)
        eased = self.x_curr.copy()
        eased[2 * dim : 2 * dim + 2] *= share
        return Ends(eased, self.x_goal)

    @cached_property
    def routes(self) -> list[Route]:
        """The shortest ways round the obstacles, the shortest first; empty where none is free."""
        margin = self.certified_margin
        found = self._found_routes(SLACK + margin)
        if not found and margin > 0.0:  # none can be certified: `safe` says so
            found, margin = self._found_routes(SLACK), 0.0
        return self._pulled_tight(found, slack=CHORD_SLACK + margin)

    def routes_with(self, slack: float) -> list[Route]:
        """Return the routes that keep `slack` m beyond robot_radius, if any."""
        return self._pulled_tight(self._found_routes(slack), slack=slack)

    def _pulled_tight(self, routes: list[Route], *, slack: float) -> list[Route]:
        return pulled_tight(
            routes,
            self.clearance_field,
            resolution=self.resolution,
            origin=self.origin,
            slack=slack,
            rays=self.rays,
        )

    def _found_routes(self, slack: float) -> list[Route]:
        return find_routes(
            self.clearance_field,
            resolution=self.resolution,
            origin=self.origin,
            start=self.x_curr[:2],
            goal=self.x_goal[:2],
            slack=slack,
            rays=self.rays,
        )

    @cached_property
    def rays(self) -> ObstacleRays:
        """Return the rays that define on which sides a path passes the obstacles."""
        return ObstacleRays.of(self.clearance_field)

    @cached_property
    def reference_s(self) -> float:
        """s that durations are measured by: the least in which the shortest route can be driven."""
        straight = float(np.linalg.norm(self.x_goal[:2] - self.x_curr[:2]))
        way = self.routes[0].length if self.routes else straight
        return self.motion.least_time(max(way, LEAST_WAY))

    @cached_property
    def route_splines(self) -> Splines:
        """One along each route; the smoothest curve between both ends where there is none."""
        leaning = CostWeights().leaning(self.w_style)
        return splines_along(
            self.routes or [self._straight],
            self.basis,
            self.ends,
            limits=self.motion,
            leaning=leaning,
        )

    @property
    def _straight(self) -> Route:
        points = np.stack([self.x_curr[:2], self.x_goal[:2]]).astype(np.float64)
        return Route(points, float(np.linalg.norm(points[1] - points[0])), ())

    @property
    def route_states(self) -> NDArray[np.float32]:
        """[R, T, 3D + 1]: p, p', p'' along each route in its own time [m], and log duration."""
        splines = self.route_splines
        states = self.basis.own_time_states(splines.control)
        lasting = np.broadcast_to(np.log(splines.duration)[:, None, None], (*states.shape[:2], 1))
        return np.concatenate([states, lasting], -1, dtype=np.float32)

    @property
    def limits(self) -> NDArray[np.float32]:
        """[4]: v_max [m/s], a_max [m/s^2], robot_radius [m], horizon_s [s], 0 where it is open."""
        motion = self.motion
        return np.array(
            [motion.v_max, motion.a_max, self.robot_radius, motion.horizon_s or 0.0], np.float32
        )

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
        """Whether a point [2] m is on the map, border included, and in a free cell."""
        upper = self.origin + self.resolution * np.array(self.occupied.shape[::-1])
        if not ((point >= self.origin) & (point <= upper)).all():
            return False
        cell = cell_index(point, self.origin, self.resolution, self.occupied.shape)
        return not self.occupied.flat[cell]


def with_neutral_channels(cost_map: FloatArray, channels: int) -> NDArray[np.float32]:
    """Return a map [C, H, W] filled up to `channels` with neutral values.

    The default is easy ground without risk: traversability 1, other channels 0.
    """
    filled = np.zeros((max(channels, len(cost_map)), *cost_map.shape[1:]), np.float32)
    filled[TRAVERSABILITY : TRAVERSABILITY + 1] = 1.0
    filled[: len(cost_map)] = cost_map
    return filled


def share_within(velocity: FloatArray, gained: FloatArray, most: float) -> float:
    """The greatest share s of [0, 1] with |velocity + s gained| <= most; |velocity| is no more."""
    a, b = float(gained @ gained), float(velocity @ gained)
    room = max(most**2 - float(velocity @ velocity), 0.0)
    if a + 2 * b <= room:
        return 1.0
    return (-b + (b * b + a * room) ** 0.5) / a
