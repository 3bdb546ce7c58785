"""The loop: look, map, ask for anchors, decide, move; until goal, collision or the time is up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_benchmarks.closed_loop.clearance_grid import ClearanceGrid
from anchorflow_benchmarks.closed_loop.lidar import Lidar
from anchorflow_benchmarks.closed_loop.local_map import LocalMap
from anchorflow_benchmarks.closed_loop.mppi import MppiController
from anchorflow_benchmarks.closed_loop.path_following import timed_paths
from anchorflow_benchmarks.closed_loop.simulated_time import SimulatedTime
from anchorflow_benchmarks.closed_loop.world import GOAL_TOLERANCE, World
from anchorflow_client.planner import Planner, PlannerConfig
from anchorflow_client.planner.plan import Plan

SUBSTEPS = 5  # of a tick: how finely motion is simulated and collisions are looked for
SLOWEST = 4.0  # times slower than it is, as which a robot may ask
OWN_DISC = 0.8  # of the robot's radius: hits within it are noise, the robot stands there
PERIOD_MS = 200.0
GOAL_CLEARANCE = 0.45  # m: local goals that are passed at speed want more room than the robot
OFF_ROUTE = 1.5  # m by which ways count as longer that are not on the planner's route
SLOW_THROUGH = 0.6  # m/s at local goals, which are passed in slow motion too


class End(Enum):
    """How a run ended."""

    GOAL = "goal"
    COLLISION = "collision"
    TIMEOUT = "timeout"


@dataclass(frozen=True)
class Run:
    """time_s: until it ended; clearance: m, smallest to any post; ticks_braked: without a plan."""

    end: End
    time_s: float
    clearance: float
    length: float
    ticks_braked: int


@dataclass(frozen=True, eq=False)
class Tick:
    """What a viewer may show of one tick.

    pose: [3]; occupied: [H, W] with its resolution and origin; ahead: [T, 2] m, what the robot is
    about to do; plan: None where nobody is asked for anchors
    """

    time_s: float
    pose: NDArray[np.floating]
    occupied: NDArray[np.bool_]
    resolution: float
    origin: NDArray[np.floating]
    ahead: NDArray[np.floating]
    plan: Plan | None


@dataclass(frozen=True)
class DriveConfig:
    """tick_s: between two commands; options: further fields of each request for anchors.

    horizon_s: that all anchors last; None: each has its own duration
    lidar_noise: m, standard deviation of a range
    cruise: m/s at which anchors that all last as long are driven, and others pass local goals
    """

    tick_s: float = 0.1
    limit_s: float = 50.0
    map_cells: int = 240
    map_resolution: float = 0.04
    horizon_s: float | None = None
    lidar_noise: float = 0.01
    cruise: float = 1.5
    options: Mapping[str, Any] = field(default_factory=dict)

    def asking(self, margin: float) -> PlannerConfig:
        """How anchors are asked for that keep a margin in m, as the controller does."""
        through_speed = self.cruise if self.horizon_s is None else SLOW_THROUGH
        return PlannerConfig(
            period_ms=PERIOD_MS,
            through_speed=through_speed,
            margin_m=margin,
            goal_clearance_m=GOAL_CLEARANCE,
        )


class Drive:
    """One robot on its way through one world; only its scans tell it of the posts."""

    def __init__(
        self,
        world: World,
        controller: MppiController,
        *,
        planner: Planner | None = None,
        clock: SimulatedTime | None = None,
        config: DriveConfig = DriveConfig(),
        seed: int = 0,
    ) -> None:
        """Stands at the start.

        Args:
            world: where.
            controller: decides, for the robot that it is made for.
            planner: brings anchors; None: MPPI is alone. Without a usable plan the robot brakes.
            clock: is advanced tick by tick; the planner's, where it lives in simulated time.
            config: ticks, map, requests.
            seed: of the lidar's noise, of each request for anchors, and of MPPI's samples, through
                torch's global generator.
        """
        self.world, self.config = world, config
        self.robot = controller.robot
        self.state: Tensor = self.robot.start(world.start)
        self._controller, self._planner = controller, planner
        self._clock = clock or SimulatedTime()
        self._lidar = Lidar(self.robot.field_of_view, noise=config.lidar_noise)
        self._map = LocalMap(cells=config.map_cells, resolution=config.map_resolution)
        self._rng = np.random.default_rng(seed)
        self._seeds = np.random.default_rng([seed, 1])
        self._clearance = world.clearance(world.start[:2], self.robot.radius)
        self._length = 0.0
        self._ticks_braked = 0
        torch.manual_seed(seed)

    def run(self, on_tick: Callable[[Tick], None] | None = None) -> Run:
        """Drive to the end; `on_tick` sees every tick before its command is carried out."""
        start = self._clock.now
        while self._clock.now - start < self.config.limit_s - 1e-6:
            command, plan = self._decide()
            if on_tick is not None:
                on_tick(self._shown(plan))
            if end := self._move(command):
                return self._ended(end, self._clock.now - start)
        return self._ended(End.TIMEOUT, self.config.limit_s)

    def _decide(self) -> tuple[Tensor, Plan | None]:
        """The control [U] for this tick, from what the lidar has shown so far."""
        robot, local = self.robot, self._map
        pose = robot.pose(self.state)
        local.add(self._lidar.scan(self.world, pose, self._rng))
        occupied = local.occupied_beyond(pose[:2], OWN_DISC * robot.radius)
        grid = ClearanceGrid.of(
            occupied,
            resolution=local.resolution,
            origin=local.origin,
            robot_radius=robot.radius,
            surface=local.surface,
        )
        goal = torch.tensor(self.world.goal, dtype=torch.float32)
        if self._planner is None:
            return self._controller.command(self.state, grid=grid, goal=goal)[0], None
        plan = self._planner.update(
            cost_map=occupied,
            resolution=local.resolution,
            origin=local.origin,
            x_curr=self._in_slow_motion(robot.x_curr(self.state)),
            x_goal=[*self.world.goal, 0.0, 0.0],
            robot_radius=robot.radius,
            v_max=robot.v_max,
            a_max=robot.a_max,
            seed=int(self._seeds.integers(2**31)),
            **self.config.options,
        )
        if not plan.usable:
            self._controller.rest()
            self._ticks_braked += 1
            return robot.braking(self.state, self.config.tick_s), plan
        assert plan.on_route is not None  # a usable plan has one
        if plan.stuck:
            self._controller.rest()
        paths, paces = timed_paths(plan, period_s=self._controller.config.dt)
        command, chosen = self._controller.command(
            self.state,
            grid=grid,
            goal=goal,
            paths=paths,
            paces=paces if self.config.horizon_s is None else None,
            handicap=OFF_ROUTE * torch.from_numpy(~plan.on_route),
        )
        if chosen is not None:
            self._planner.follow(chosen)
        return command, plan

    def _in_slow_motion(self, x_curr: NDArray[np.floating]) -> NDArray[np.floating]:
        """A state [6] whose anchors, driven faster than they were asked for, are at cruise.

        An anchor that takes the whole horizon to the goal, however near that is, would send a fast
        robot on detours. So it asks as if its time ran slower; the way is the same. Where each
        anchor has its own duration, the state is as it is.
        """
        config, place = self.config, x_curr[:2]
        if config.horizon_s is None:
            return x_curr
        beside = 0.5 * config.map_cells * config.map_resolution
        way = min(float(np.linalg.norm(self.world.goal - place)), beside)
        slower = np.clip(config.horizon_s * config.cruise / way, 1.0, SLOWEST)
        return np.concatenate([place, x_curr[2:4] / slower, x_curr[4:] / slower**2])

    def _move(self, command: Tensor) -> End | None:
        """Carry a command out for a tick."""
        step_s = self.config.tick_s / SUBSTEPS
        for _ in range(SUBSTEPS):
            before = self.robot.pose(self.state)[:2]
            self.state = self.robot.step(self.state, command, step_s)
            self._clock.advance(step_s)
            place = self.robot.pose(self.state)[:2]
            self._length += float(np.linalg.norm(place - before))
            clearance = self.world.clearance(place, self.robot.radius)
            self._clearance = min(self._clearance, clearance)
            if clearance < 0.0:
                return End.COLLISION
            if np.linalg.norm(place - self.world.goal) <= GOAL_TOLERANCE:
                return End.GOAL
        return None

    def _shown(self, plan: Plan | None) -> Tick:
        return Tick(
            time_s=self._clock.now,
            pose=self.robot.pose(self.state),
            occupied=self._map.occupied,
            resolution=self._map.resolution,
            origin=self._map.origin,
            ahead=self._controller.planned(self.state)[:, :2].numpy(),
            plan=plan,
        )

    def _ended(self, end: End, time_s: float) -> Run:
        return Run(end, time_s, self._clearance, self._length, self._ticks_braked)
