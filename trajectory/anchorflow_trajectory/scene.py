"""A scene: one planning problem, and the fields that follow from its map."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.caching import cached_property
from anchorflow_trajectory.cost import clearance
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.cost.fields import (
    OCCUPANCY,
    RISK,
    TRAVERSABILITY,
    CostFields,
    soft_cost,
)
from anchorflow_trajectory.cost.trajectory_cost import CostWeights, TrajectoryCost
from anchorflow_trajectory.motion import MotionLimits, nominal_duration, share_within
from anchorflow_trajectory.movers import Discs, MovingDiscs
from anchorflow_trajectory.routes.dijkstra import cell_index
from anchorflow_trajectory.routes.homotopy import ObstacleRays
from anchorflow_trajectory.routes.offered import RouteSearch
from anchorflow_trajectory.routes.passing import WAITS, Ways, passing_keys, ways_past
from anchorflow_trajectory.routes.search import Route
from anchorflow_trajectory.routes.space_time import SpaceTime
from anchorflow_trajectory.routes.splines import (
    LEAST_WAY,
    STRETCH,
    RouteSplines,
    splines_along,
    splines_through,
    spread_round,
    usual_spread,
)
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
NETWORK_CHANNELS = 3  # obstacles, traversability (all of it is 1), risk (dear ground)
NUM_STEPS = 64
# A style with a weight beyond BALANCED leans further than it says, and most from LEANING on: its
# weights are raised to this power beside the cost's own contrast.
BALANCED, LEANING, EMPHASIS = 0.42, 0.5, 3.0
COST_PENALTY = 3.0  # m of detour that one metre through soft cost 1 is worth
HURRY, CLOSE = 0.94, 0.05  # share of v_max of ways over places and times, and m that they keep
DETOUR, LEAST_DETOUR = 0.3, 3.0  # of the shortest way, and m, that ways over time are longer
RESERVE = 1.1  # times the shortest way, which the cruise of a horizon covers
LONGEST_STRETCH = 3.0  # of the reference time, that anchors last as a rule
FIRST_GAIN = 0.2  # of an acceleration's effect in one span is what shows before it is taken back
MARGIN = 0.05  # m of clearance at which the cost of a collision begins, if nothing else is asked
LATE = CostWeights(smooth=0.1, limit_share=0.985)  # of who is late: less smooth, nearer to limits
# Of who may take any time among what moves. With a low price of time the way past everybody is to
# wait, at each request anew: robots stood where people came and went.
GOING = CostWeights(time=10.0)
TOP_SPEED = 0.97  # share of v_max


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """One planning problem in SI and its map's frame; derived fields are cached.

    cost_map: float32 [C, H, W] in [0, 1]: occupancy, traversability, risk, further soft costs
    resolution: m/cell; origin: float64 [2] m, outer corner of cell (0, 0); robot_radius: m
    x_curr: [3D] p, v, a in m, m/s, m/s^2; x_goal: [2D] p, v; D = 3 adds a heading in rad
    w_style: [3] weights of safety, energy and smoothness, which sum to 1, as they were asked for
    motion: what anchors keep
    basis: of the splines along the routes
    certified_margin: m beyond robot_radius that routes keep, where any can
    cost_penalty: m of detour that one metre through soft cost 1 is worth
    channel_weights: [C - 1] of traversability, risk and further channels; none: 1 each
    movers: what moves, from the moment of x_curr on
    is_late: whether the goal as it was asked for is out of reach within the horizon
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
    cost_penalty: float = COST_PENALTY
    channel_weights: FloatArray | None = None
    movers: MovingDiscs | None = None
    is_late: bool = False

    @cached_property
    def occupied(self) -> NDArray[np.bool_]:
        """[H, W], the cells of obstacles."""
        return self.cost_map[0] >= clearance.OCCUPIED

    @cached_property
    def clearance_field(self) -> NDArray[np.float32]:
        """[H, W] m beyond robot_radius at cell centres, negative inside obstacles."""
        return clearance.clearance_field(self.occupied, self.resolution, self.robot_radius)

    @cached_property
    def surcharge(self) -> NDArray[np.float32] | None:
        """[H, W] m of detour that a metre of way through a cell is worth; None if it is 0."""
        soft = soft_cost(self.cost_map, self.channel_weights)
        soft *= np.float32(self.cost_penalty)
        return soft if soft.any() else None

    @property
    def network_map(self) -> NDArray[np.float32]:
        """[3, H, W] as networks see the map: obstacles, 1, and the surcharge scaled to [0, 1)."""
        seen = np.zeros((NETWORK_CHANNELS, *self.occupied.shape), np.float32)
        seen[OCCUPANCY], seen[TRAVERSABILITY] = self.occupied, 1.0
        if self.surcharge is not None:
            seen[RISK] = self.surcharge / (self.surcharge + COST_PENALTY)
        return seen

    @cached_property
    def effective_style(self) -> FloatArray:
        """Return the weights [3] with which the cost and networks work."""
        lean = np.clip((float(self.w_style.max()) - BALANCED) / (LEANING - BALANCED), 0.0, 1.0)
        if lean == 0.0:
            return self.w_style
        raised = self.w_style ** (1.0 + (EMPHASIS - 1.0) * lean)
        return raised / raised.sum()

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
        """The cheapest ways round the obstacles, the cheapest first; empty where none is free."""
        within = None
        if self.movers is not None and self.occupied.any():
            within, dim = np.inf, len(self.x_goal) // 2
            if (horizon := self.motion.horizon_s) is not None:
                begin, end = (np.linalg.norm(x[dim : dim + 2]) for x in (self.x_curr, self.x_goal))
                within = self.motion.most_way(horizon, float(begin), float(end))
        return self.route_search.offered(self.certified_margin, roomy_within=within)

    @cached_property
    def route_search(self) -> RouteSearch:
        """Return the search for routes on this map."""
        return RouteSearch(
            self.clearance_field,
            self.surcharge,
            self.resolution,
            self.origin,
            self.x_curr[:2],
            self.x_goal[:2],
            self.rays,
        )

    @cached_property
    def rays(self) -> ObstacleRays:
        """Return the rays that define on which sides a path passes the obstacles."""
        return ObstacleRays.of(self.clearance_field, self.surcharge)

    @cached_property
    def reference_s(self) -> float:
        """s that durations are measured by: the least in which the shortest route can be driven."""
        return self.motion.least_time(max(self.shortest_way, LEAST_WAY))

    @property
    def shortest_way(self) -> float:
        """m, the length of the shortest route."""
        straight = float(np.linalg.norm(self.x_goal[:2] - self.x_curr[:2]))
        return min((route.length for route in self.routes), default=straight)

    @cached_property
    def ways(self) -> Ways:
        """Return the ways in space and time: one a route where nothing moves."""
        along = self._along_routes
        if self.movers is None:
            return Ways(along)
        return ways_past(along, self.cost(), self.ends, until=self.until_s, more=self._over_time)

    def classes(self, positions: FloatArray, duration: FloatArray) -> list[Hashable]:
        """Return a value for each of the motions [N, T, D] in `duration` [N] s.

        They are equal for those that pass everything, still or moving, on the same sides.
        """
        plane = positions[..., :2]
        found: list[Hashable] = [()] * len(positions)
        if len(self.rays.rows):
            found = [*self.rays.signatures(plane, resolution=self.resolution, origin=self.origin)]
        if self.cost_fields.movers is None:
            return found
        discs = Discs.of(self.cost_fields.movers, np.float32)
        until = max(self.until_s, float(duration.max()))
        keys = passing_keys(discs, np.ascontiguousarray(plane, np.float32), duration, until)
        return list(zip(found, keys.tolist(), strict=True))

    @property
    def is_touched(self) -> bool:
        """Whether something that moves, or a wall, touches the robot at the start already."""
        fields, start = self.cost_fields, self.x_curr[:2]
        if float(fields.clearance.sample(*start.astype(np.float32))) < 0.0:
            return True
        if fields.movers is None or not len(fields.movers.radius):
            return False
        apart = np.linalg.norm(fields.movers.places[:, 0] - start, axis=-1)
        return bool((apart < fields.movers.radius).any())

    @cached_property
    def hurried(self) -> tuple[SpaceTime, MotionLimits]:
        """Return `space_time` of who hurries past closely."""
        return self.space_time(HURRY, CLOSE)

    def space_time(self, hurry: float, room: float) -> tuple[SpaceTime, MotionLimits]:
        """Return the swept places and times, and the motion limits with the horizon swept.

        hurry: share of v_max that ways reach
        room: m that they keep from what moves
        """
        dim, motion = len(self.x_goal) // 2, self.motion
        if motion.horizon_s is None:
            motion = replace(
                motion, horizon_s=nominal_duration(self.shortest_way, motion) + WAITS[0]
            )
        ends = self.x_curr[:2], self.x_curr[dim : dim + 2], self.x_goal[:2]
        longest = self.shortest_way + max(DETOUR * self.shortest_way, LEAST_DETOUR)
        fields = self.cost_fields
        found = SpaceTime.of(fields, motion, *ends, longest=longest, hurry=hurry, room=room)
        return found, motion

    @property
    def _over_time(self) -> Splines | None:
        """Return the cheapest ways over places and times to the goal.

        None without a horizon, and in the open, where manoeuvres do as well in less time.
        """
        if self.motion.horizon_s is None or not self.occupied.any():
            return None
        lattice, _ = self.hurried
        places, _ = lattice.ways_to(lattice.node(self.x_goal[:2]), self.basis.num_samples)
        if not len(places):
            return None
        lasting = np.full(len(places), self.motion.horizon_s)
        return splines_through(places, self.basis, self.ends, lasting)

    @property
    def until_s(self) -> float:
        """s after which ways do not differ any more."""
        return self.motion.horizon_s or LONGEST_STRETCH * self.reference_s

    @property
    def route_splines(self) -> Splines:
        """One along each of the ways."""
        return self.ways.splines

    def cost(self, margin: float = MARGIN) -> TrajectoryCost:
        """Return the cost of trajectories; margin: m of clearance at which hinges begin."""
        usual = GOING if self.movers is not None and not self.motion.horizon_s else CostWeights()
        return TrajectoryCost(
            self.basis,
            self.cost_fields,
            self.motion,
            self.effective_style,
            self.reference_s,
            margin,
            weights=LATE if self.is_late else usual,
            cruise=self._cruise,
        )

    @cached_property
    def _cruise(self) -> float | None:
        """m/s at which the shortest way takes the horizon, with some of it left, among what moves.

        Who would wait, or go round, and hurry afterwards is late as soon as somebody is in the way.
        """
        horizon = self.motion.horizon_s
        if self.movers is None or horizon is None:
            return None
        dim, begin = len(self.x_goal) // 2, self.x_curr
        speeds = [float(np.linalg.norm(x[dim : dim + 2])) for x in (begin, self.x_goal)]
        return self.motion.least_cruise(RESERVE * self.shortest_way, horizon, *speeds)

    @cached_property
    def _along_routes(self) -> Splines:
        """One along each route; the smoothest curve between both ends where there is none."""
        leaning = CostWeights().leaning(self.effective_style)
        return splines_along(
            self.routes or [self._straight],
            self.basis,
            self.ends,
            limits=self.motion,
            leaning=leaning,
        )

    @property
    def cheapest(self) -> Route:
        return self.routes[0] if self.routes else self._straight

    @property
    def _straight(self) -> Route:
        points = np.stack([self.x_curr[:2], self.x_goal[:2]]).astype(np.float64)
        return Route(points, float(np.linalg.norm(points[1] - points[0])), ())

    @property
    def route_states(self) -> NDArray[np.float32]:
        """[R, T, 3D + 1]: p, p', p'' along each route in its own time [m], and log duration."""
        return self.states_of(self.route_splines)

    def states_of(self, splines: Splines) -> NDArray[np.float32]:
        """Return p, p', p'' of splines in their own time [m] and log duration: [N, T, 3D + 1]."""
        states = self.basis.own_time_states(splines.control)
        lasting = np.broadcast_to(np.log(splines.duration)[:, None, None], (*states.shape[:2], 1))
        return np.concatenate([states, lasting], -1, dtype=np.float32)

    def spread_round_routes(self, tries: int, rng: np.random.Generator) -> RouteSplines:
        """Return `tries` splines about those of the routes, dealt out in turn."""
        return spread_round(
            self.route_splines,
            self.basis,
            tries=tries,
            rng=rng,
            spread=usual_spread(self.ends),
            stretch=STRETCH if self.motion.horizon_s is None else 0.0,
        )

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
        at = self.resolution, self.origin
        dear = None if self.surcharge is None else GridField(self.surcharge, *at)
        movers = self.movers and self.movers.wider(self.robot_radius)
        return CostFields(GridField(self.clearance_field, *at), dear, movers)

    @property
    def map_geometry(self) -> NDArray[np.float32]:
        """[3]: origin x and y [m], resolution [m/cell]."""
        return np.array([*self.origin, self.resolution], np.float32)

    def inputs(self, names: Iterable[str]) -> dict[str, NDArray[np.float32]]:
        """The arrays of these names, out of SCENE_INPUTS, in float32 and with a B axis of 1."""
        seen = {"cost_map": "network_map", "w_style": "effective_style"}
        return {
            name: np.asarray(getattr(self, seen.get(name, name)), np.float32)[None]
            for name in names
        }

    def is_free(self, point: FloatArray) -> bool:
        """Whether a point [2] m is on the map, border included, and in a free cell."""
        upper = self.origin + self.resolution * np.array(self.occupied.shape[::-1])
        if not ((point >= self.origin) & (point <= upper)).all():
            return False
        cell = cell_index(point, self.origin, self.resolution, self.occupied.shape)
        return not self.occupied.flat[cell]
