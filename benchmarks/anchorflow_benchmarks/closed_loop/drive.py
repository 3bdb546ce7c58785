"""The control loop: scan, map, request anchors, decide and move until the run ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from time import process_time
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_benchmarks.closed_loop.controllers import Controller, Sight
from anchorflow_benchmarks.closed_loop.lidar_mapping import Lidar, LocalMap
from anchorflow_benchmarks.closed_loop.simulated_time import SimulatedTime
from anchorflow_benchmarks.closed_loop.worlds import GOAL_TOLERANCE, World
from anchorflow_client.planner import Planner, PlannerConfig
from anchorflow_client.planner.plan import Plan

SUBSTEPS = 5  # of a tick, for the simulated motion and collision checks
MAX_SLOWDOWN = 4.0  # of time in a request
OWN_DISC = 0.8  # of the robot's radius; hits within it are noise
PERIOD_MS = 200.0
GOAL_CLEARANCE = 0.45  # m round local goals, which are passed at speed
SLOW_THROUGH = 0.6  # m/s at local goals in slow motion


class End(Enum):
    GOAL = "goal"
    COLLISION = "collision"
    TIMEOUT = "timeout"


@dataclass(frozen=True)
class Run:
    """time_s: duration; clearance: m, smallest to any post; ticks_braked: without a plan."""

    end: End
    time_s: float
    clearance: float
    length: float
    ticks_braked: int


@dataclass(frozen=True, eq=False)
class Tick:
    """The state of one tick, for a viewer.

    pose: [3]; occupied: [H, W] with its resolution and origin; ahead: [T, 2] m, the planned
    motion; plan: None without a planner
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

    horizon_s: duration of all anchors; None if each has its own
    lidar_noise: m, standard deviation of a range
    cruise: m/s along anchors of equal duration, and past the local goals of others
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
        """Return the planner's settings for anchors with the controller's margin in m."""
        through_speed = self.cruise if self.horizon_s is None else SLOW_THROUGH
        return PlannerConfig(
            period_ms=PERIOD_MS,
            through_speed=through_speed,
            margin_m=margin,
            goal_clearance_m=GOAL_CLEARANCE,
        )


class Drive:
    """One robot on its way through one world, which it knows only from its scans."""

    def __init__(
        self,
        world: World,
        controller: Controller,
        *,
        planner: Planner | None = None,
        clock: SimulatedTime | None = None,
        config: DriveConfig = DriveConfig(),
        seed: int = 0,
    ) -> None:
        """Place the robot at the start.

        planner: provides anchors; None for MPPI alone. Without a usable plan the robot brakes.
        clock: advanced tick by tick; share it with a planner in simulated time
        seed: of the lidar's noise, of requests, and of MPPI's samples through torch's global
            generator
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
        self._clearance = self.robot.room(world, self.state)
        self._length = 0.0
        self._ticks_braked = 0
        self.commands_s: list[float] = []
        """Processor time of each command."""
        torch.manual_seed(seed)

    def run(self, on_tick: Callable[[Tick], None] | None = None) -> Run:
        """Drive to the end; `on_tick` gets every tick before its command is executed."""
        start = self._clock.now
        while self._clock.now - start < self.config.limit_s - 1e-6:
            command, plan = self._decide()
            if on_tick is not None:
                on_tick(self._shown(plan))
            if end := self._move(command):
                return self._ended(end, self._clock.now - start)
        return self._ended(End.TIMEOUT, self.config.limit_s)

    def _decide(self) -> tuple[Tensor, Plan | None]:
        """Return the control [U] for this tick, and the plan behind it."""
        robot, local = self.robot, self._map
        pose = robot.pose(self.state)
        local.add(self._lidar.scan(self.world, pose, self._rng))
        occupied = local.occupied_beyond(pose[:2], OWN_DISC * robot.radius)
        sight = Sight(occupied, local.resolution, local.origin, local.surface)
        if self._planner is None:
            return self._commanded(sight)[0], None
        plan = self._planner.update(
            cost_map=occupied,
            resolution=local.resolution,
            origin=local.origin,
            x_curr=self._in_slow_motion(robot.x_curr(self.state)),
            x_goal=[*self.world.goal, *np.zeros(2 if robot.half is None else 4)],
            v_max=robot.v_max,
            a_max=robot.a_max,
            seed=int(self._seeds.integers(2**31)),
            **robot.options,
            **self.config.options,
        )
        if not plan.usable:
            self._controller.rest()
            self._ticks_braked += 1
            return robot.braking(self.state, self.config.tick_s), plan
        if plan.stuck:
            self._controller.rest()
        command, chosen = self._commanded(sight, plan)
        if chosen is not None:
            self._planner.follow(chosen)
        return command, plan

    def _commanded(self, sight: Sight, plan: Plan | None = None) -> tuple[Tensor, int | None]:
        """Return the controller's control [U] and the anchor it follows, and time it."""
        began = process_time()
        command = self._controller.command(self.state, sight=sight, goal=self.world.goal, plan=plan)
        self.commands_s.append(process_time() - began)
        return command

    def _in_slow_motion(self, x_curr: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the state [6] in slowed time, if all anchors have the same duration.

        Such an anchor takes the whole horizon to the goal, however near, which would send a fast
        robot on detours. In slowed time the way is the same, and it is driven at cruise speed.
        """
        config, place = self.config, x_curr[:2]
        if config.horizon_s is None:
            return x_curr
        beside = 0.5 * config.map_cells * config.map_resolution
        way = min(float(np.linalg.norm(self.world.goal - place)), beside)
        slower = np.clip(config.horizon_s * config.cruise / way, 1.0, MAX_SLOWDOWN)
        return np.concatenate([place, x_curr[2:4] / slower, x_curr[4:] / slower**2])

    def _move(self, command: Tensor) -> End | None:
        """Execute a command for a tick."""
        step_s = self.config.tick_s / SUBSTEPS
        for _ in range(SUBSTEPS):
            before = self.robot.pose(self.state)[:2]
            self.state = self.robot.step(self.state, command, step_s)
            self._clock.advance(step_s)
            place = self.robot.pose(self.state)[:2]
            self._length += float(np.linalg.norm(place - before))
            clearance = self.robot.room(self.world, self.state)
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
            ahead=self._controller.planned(self.state),
            plan=plan,
        )

    def _ended(self, end: End, time_s: float) -> Run:
        return Run(end, time_s, self._clearance, self._length, self._ticks_braked)
