"""A driver in traffic that reacts: routes on simulated nets, judged by what happened."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from anchorflow_driving.drivers import PLAN_TIMES, Driver
from anchorflow_driving.errors import SimulationError
from anchorflow_driving.geometry import Array, into_frame, out_of_frame
from anchorflow_driving.late_driver import begins_s
from anchorflow_driving.log import (
    FRAME_S,
    FUTURE_FRAMES,
    NO_WINDOWS,
    SIMULATED,
    VEHICLE,
    DrivingLog,
    track_fields,
)
from anchorflow_driving.pdm.collisions import Placement, find_contacts, no_collision
from anchorflow_driving.pdm.score import tracked
from anchorflow_driving.pdm.traffic import Others, Traffic
from anchorflow_driving.route import ROUTE_SIGMA, SPACING, Route, smooth_line
from anchorflow_driving.simulation.demand import make_demand
from anchorflow_driving.simulation.driven import (
    DrivenLog,
    RouteProgress,
    comfortable_stretches,
    first_steps,
    joined,
    rest_of,
    state_after,
)
from anchorflow_driving.simulation.road_net import RoadNet
from anchorflow_driving.simulation.roadside import all_that_stands
from anchorflow_driving.simulation.routes import line_ahead
from anchorflow_driving.simulation.simulated_log import net_fields
from anchorflow_driving.simulation.street_plan import make_net
from anchorflow_driving.simulation.sumo_traffic import LiveTraffic
from anchorflow_driving.window import EgoState, PlannerView, Scenes, Vehicle, Window, planner_view
from anchorflow_driving.window_choice import command, fits_ego
from anchorflow_trajectory.car.tracking import Motion

ATTEMPTS = 10
"""Draws until a vehicle is found that can drive so far."""
LEAST_SPEED = 3.0
"""m/s of the vehicle that is taken over: a driver that holds its speed must not start at rest."""
BEHIND, AHEAD = 20.0, 150.0
"""m of the route that a planner is given."""
COMMAND_S = 4.5
DENSEST = 12.0
"""Vehicles a lane and kilometre: denser queues without lights would not clear in time."""


@dataclass(frozen=True)
class ClosedLoopConfig:
    """How routes are driven.

    length_m: of a route; seconds: after which it is given up; replan_s: between two plans
    delay_s: from what a driver sees to its plan, which is driven from then on; less than replan_s
    """

    seed: int = 2000
    length_m: float = 300.0
    seconds: float = 90.0
    replan_s: float = 0.5
    delay_s: float = 0.0


@dataclass(frozen=True)
class RouteResult:
    """What happened on a route, which ends with the first of its outcomes.

    outcome: completed, collision, off road, off route or time
    progress_m: of the route, that was passed; driven_m: wherever that was
    comfortable: of each stretch of 4 s, one after the other, and of the last 4 s
    """

    outcome: str
    progress_m: float
    driven_m: float
    seconds: float
    comfortable: list[bool] = field(repr=False)
    plan_ms: list[float] = field(repr=False)


class LiveWindow(Window):
    """The window of a live drive: it has a view and no recorded future."""

    def __init__(
        self, view: PlannerView, scenes: Scenes, *, meanwhile: Array | None = None
    ) -> None:
        self.meanwhile = meanwhile
        self.view, self.state, self.vehicle = view, view.state, view.vehicle
        self.log, self.road, self.ego = scenes.log, scenes.road, view.ego
        self.index = self.frame = 0
        self.command, self.speed_limit = view.command, view.speed_limit

    def recorded(self, times: Array) -> Array:
        raise SimulationError(f"nothing is recorded of the next {max(times):g} s: they are driven")


def drive_route(
    driver: Driver,
    config: ClosedLoopConfig,
    index: int,
    *,
    keep: Callable[[DrivingLog], None] | None = None,
) -> RouteResult:
    """One route; its net, its traffic and its start depend on the seed and the index alone.

    Junctions have no traffic lights, since no planner has them as input.

    keep: takes the drive as a log, as `DrivenLog` makes it. The driver then drives on past the
        route's end, so that the last window has its future.

    Raises `SimulationError` if SUMO fails, or no vehicle is found that can drive so far.
    """
    name = f"driven-{config.seed}-{index:05d}"
    kept = None if keep is None else lambda noted: keep(noted.log(name))
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([config.seed, index, attempt])
        with tempfile.TemporaryDirectory() as folder:
            result = _drive(driver, config, rng, Path(folder), kept)
        if result is not None:
            return result
    raise SimulationError(f"route {index}: no vehicle can drive {config.length_m:g} m")


def _drive(
    driver: Driver,
    config: ClosedLoopConfig,
    rng: np.random.Generator,
    folder: Path,
    keep: Callable[[DrivenLog], None] | None,
) -> RouteResult | None:
    path = make_net(rng, folder, lights=False)
    net = RoadNet(path)
    warm_up_s = float(rng.uniform(12.0, 35.0))
    demand = make_demand(
        net, rng, folder, warm_up_s=warm_up_s, seconds=config.seconds, densest=DENSEST
    )
    fields = net_fields(net, level=0.2, mirror=1.0)
    scenes = Scenes(_bare_log(fields))
    standing = all_that_stands(net, rng)
    with LiveTraffic(path, demand, seed=int(rng.integers(2**31)), standing=standing) as traffic:
        for _ in range(round(warm_up_s / FRAME_S)):
            traffic.step()
        for name in rng.permutation(traffic.vehicles):
            line = _line_of(net, traffic, str(name), length=config.length_m)
            if line is not None:
                noted = DrivenLog(traffic, str(name), fields)
                drive = _Drive(driver, config, traffic, scenes, str(name), line, net, noted)
                result = drive.go(on_s=0.0 if keep is None else FUTURE_FRAMES * FRAME_S)
                if keep is not None:
                    keep(noted)
                return result
    return None


def _line_of(net: RoadNet, traffic: LiveTraffic, name: str, *, length: float) -> Array | None:
    """The centreline of a vehicle's route, if it can be taken over here and drive so far."""
    lane, position = traffic.lane_of(name)
    fits = traffic.kind_of(name) == VEHICLE and fits_ego(traffic.size_of(name)[0])
    fast = np.hypot(*traffic.state_of(name)[3:]) > LEAST_SPEED
    if not (fits and fast and lane in net.lanes and not net.lanes[lane].in_junction):
        return None
    points = line_ahead(
        net, net.lanes[lane], position, traffic.route_ahead(name), length=length + 2 * AHEAD
    )
    behind = traffic.state_of(name)[:2]
    if np.linalg.norm(points[0] - behind) > 1.0:
        points = np.concatenate([behind[None], points])
    line = smooth_line(points, before=BEHIND, sigma=ROUTE_SIGMA)
    return line if (len(line) - 1) * SPACING > length + BEHIND + 20.0 else None


class _Drive:
    """A vehicle that follows a driver's plans until its route ends."""

    def __init__(
        self,
        driver: Driver,
        config: ClosedLoopConfig,
        traffic: LiveTraffic,
        scenes: Scenes,
        ego: str,
        line: Array,
        net: RoadNet,
        noted: DrivenLog,
    ) -> None:
        self._driver, self._config, self._traffic, self._ego = driver, config, traffic, ego
        self._scenes, self._line, self._net, self._noted = scenes, line, net, noted
        self._vehicle = Vehicle(*traffic.size_of(ego))
        self._touched: set[str] = set()
        self._progress = RouteProgress(line, begin=BEHIND)
        self._motions: list[Motion] = []
        self._state: EgoState | None = None
        self._rest: Motion | None = None
        self._plan_ms: list[float] = []
        self._limit = 13.9
        traffic.take_over(ego)

    def go(self, *, on_s: float) -> RouteResult:
        """Drive the route; on_s: seconds to drive after its end, without judging them."""
        outcome = "time"
        for _ in range(round(self._config.seconds / self._config.replan_s)):
            fault = self._replan()
            if fault is not None:
                outcome = fault
                break
            if self._progress.passed >= self._config.length_m:
                outcome = "completed"
                break
        driven = joined(self._motions)
        result = RouteResult(
            outcome=outcome,
            progress_m=self._progress.passed,
            driven_m=float(np.abs(driven.speed[:, 1:]).sum()) * FRAME_S,
            seconds=(driven.speed.shape[1] - 1) * FRAME_S,
            comfortable=comfortable_stretches(driven),
            plan_ms=list(self._plan_ms),
        )
        for _ in range(math.ceil(on_s / self._config.replan_s)):
            self._replan()
        return result

    def _replan(self) -> str | None:
        """Drive one plan, after the last one until it arrives; return the outcome of a fault."""
        window = self._window()
        seen, late = window.view.state, round(self._config.delay_s / FRAME_S)
        started = perf_counter()
        plan = self._driver(window, PLAN_TIMES)
        self._plan_ms.append(1e3 * (perf_counter() - started))
        begin, fault = seen, None
        if late:
            fault = self._execute(self._ahead_of(seen), late)
            begin = state_after(self._ahead_of(seen), late)
        if begins_s(self._driver):
            plan = into_frame(out_of_frame(plan, seen.pose), begin.pose)
        motion = tracked(plan[None], begin, self._vehicle)
        steps = round(self._config.replan_s / FRAME_S) - late
        self._state, self._rest = state_after(motion, steps), rest_of(motion, steps)
        return self._execute(motion, steps) if fault is None else fault

    def _ahead_of(self, state: EgoState) -> Motion:
        """Return what is left of the last plan, or straight on before the first."""
        if self._rest is None:
            times = PLAN_TIMES
            plan = np.stack([state.speed * times, 0 * times, 0 * times], -1)
            self._rest = tracked(plan[None], state, self._vehicle)
        return self._rest

    def _window(self) -> LiveWindow:
        seen = self._traffic.seen()
        lane, _ = self._traffic.lane_of(self._ego)
        if lane in self._net.lanes:
            self._limit = self._net.lanes[lane].speed
        ego = seen.names.index(self._ego)
        middle = seen.states[ego, -1]
        self._progress.advance(middle[:2])
        now, speed = self._progress.place, float(np.hypot(*middle[3:]))
        begin, end = (round((now + away) / SPACING) for away in (-BEHIND, AHEAD))
        route = self._line[max(begin, 0) : end]
        asked = command(self._line, now, now + COMMAND_S * speed)
        self._noted.note_window(route, asked, self._limit)
        view = planner_view(
            seen.states,
            ego=ego,
            track_type=seen.kind,
            track_size=seen.size,
            route=route,
            command=asked,
            speed_limit=self._limit,
            scenes=self._scenes,
        )
        # The rollout's own state has no errors of finite differences.
        view = view if self._state is None else replace(view, state=self._state)
        meanwhile = into_frame(self._ahead_of(view.state).poses[0], view.state.pose)
        seconds = FRAME_S * np.arange(len(meanwhile))
        return LiveWindow(view, self._scenes, meanwhile=np.c_[seconds, meanwhile])

    def _execute(self, motion: Motion, stride: int) -> str | None:
        """Drive `stride` steps; return the outcome if they end the route."""
        for step in range(1, stride + 1):
            middle = self._vehicle.middles(motion.poses[0, step])
            self._traffic.step(self._ego, middle, float(motion.speed[0, step]))
            self._noted.note_frame()
        driven = first_steps(motion, stride)
        self._motions.append(driven)
        seen = self._traffic.seen()
        ego = seen.names.index(self._ego)
        self._progress.advance(seen.states[ego, -1, :2])
        unknown = {*seen.names} - {self._ego, *self._touched}
        kept = [index for index, name in enumerate(seen.names) if name in unknown]
        others = Others(seen.states[kept, -stride - 1 :], seen.size[kept], seen.kind[kept])
        road, start = self._scenes.road, EgoState(np.zeros(3), 0.0, 0.0, 0.0)
        scene = Traffic(road, Route(self._line), self._vehicle, start, np.nan, others)
        placement = Placement(driven, self._vehicle, road)
        off_road = np.append(np.flatnonzero(placement.off_road[0]), np.inf)[0]
        _, (collision,) = no_collision(driven, scene, placement)
        if np.isfinite(min(collision, off_road)):
            return "collision" if collision <= off_road else "off road"
        if self._progress.is_lost:
            return "off route"
        contacts = find_contacts(driven, scene, ahead=0)
        self._touched |= {seen.names[kept[i]] for i in contacts.track.tolist()}
        return None


def _bare_log(fields: dict) -> DrivingLog:
    """A log of a map alone."""
    return DrivingLog(
        name="closed loop",
        source=SIMULATED,
        licence="none",
        city="",
        dt=FRAME_S,
        **track_fields([VEHICLE], [(1.0, 1.0)], np.full((1, 1, 5), np.nan)),
        **fields,
        **NO_WINDOWS,
    )
