"""A robot that is driven by the node's decisions in simulated time, in one process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from ros_messages import Messages

from anchorflow_benchmarks.closed_loop.simulated_time import LatencyExecutor, SimulatedTime
from anchorflow_client import AnchorBatch, AnchorRequest, ConnectionFailed
from anchorflow_ros.driver import Decision, Driver
from anchorflow_ros.frames import ORIGIN, Pose
from anchorflow_ros.parameters import Settings
from anchorflow_ros.simulation import Base

LATENCY_S = 0.06
TICK_S = 0.05
OPTIONS = '{"seed": 1, "sampler": {"method": "midpoint", "schedule": {"uniform": 2}}}'


class Switched:
    """A client that can be switched off, as if its service were killed."""

    def __init__(self, plan_request: Callable[[AnchorRequest], AnchorBatch]) -> None:
        self.off = False
        self.requests: list[AnchorRequest] = []
        self._plan_request = plan_request

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        self.requests.append(request)
        if self.off:
            raise ConnectionFailed("nobody listens at 127.0.0.1:8000")
        return self._plan_request(request)


class Rehearsal:
    """The robot, its messages and its clock.

    odometry, maps: whether these are published
    cells: [H, W] percent of the map, with its corner at `corner`
    """

    def __init__(self, client: Switched, *, start: Pose = ORIGIN, **given: Any) -> None:
        self.make, self.client = Messages(), client
        self.clock, self.steady = SimulatedTime(), 100.0
        self.clock.now = 50.0
        parameters = {name.replace("__", "."): value for name, value in given.items()}
        self.settings = Settings.of(
            {"service.num_samples": 8, "service.options": OPTIONS, **parameters}
        )
        executor = LatencyExecutor(self.clock, fixed_s=LATENCY_S)
        self.driver = Driver(self.settings, client, executor=executor)
        self.base = Base(start)
        self.odometry = self.maps = True
        self.cells, self.corner = np.zeros((64, 80), np.int8), (-2.0, -3.2)

    @property
    def inputs(self) -> Any:
        return self.driver.inputs

    def go(self, x: float, y: float, **options: Any) -> None:
        """Send a goal."""
        self.inputs.on_goal(self.make.goal(x, y, **options))

    def tick(self) -> Decision:
        """Publish, decide and move for a tick."""
        now, pose = self.clock.now, self.base.pose
        if self.maps:
            grid = self.make.grid(self.cells, resolution=0.1, origin=self.corner, stamp=now)
            self.inputs.on_map(grid, now=now)
        if self.odometry:
            twist = (self.base.v, 0.0, self.base.w)
            message = self.make.odometry(pose.x, pose.y, pose.yaw, twist=twist, stamp=now)
            self.inputs.on_odometry(message)
        decision = self.driver.tick(now, steady=self.steady)
        self.base.step(decision.twist[0], decision.twist[2], TICK_S)
        self.clock.advance(TICK_S)
        self.steady += TICK_S
        return decision

    def run(self, seconds: float) -> list[Decision]:
        """Return the decisions of a time."""
        return [self.tick() for _ in range(round(seconds / TICK_S))]

    def run_until(self, done: Callable[[Decision], bool], limit_s: float = 15.0) -> list[Decision]:
        """Return the decisions up to the first one that fits, or of `limit_s`."""
        decisions: list[Decision] = []
        while len(decisions) * TICK_S < limit_s and not (decisions and done(decisions[-1])):
            decisions.append(self.tick())
        return decisions
