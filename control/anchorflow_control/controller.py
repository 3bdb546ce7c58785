"""Model predictive path integral control (Williams et al., 2017) that begins from anchors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract import AnchorBatch, CostMap, Obstacles
from anchorflow_client.contract.checks import Interval, number, numbers, wrong_shape
from anchorflow_client.contract.ranges import COORDINATE, V_MAX
from anchorflow_client.planner import Plan
from anchorflow_control.command import Command
from anchorflow_control.config import MppiConfig
from anchorflow_control.robot import Robot, wrapped

TICK = Interval(0.0, 1.0, "s", open_low=True)


class MppiController:
    """Controls one robot: call `command` at every tick, from one thread."""

    def __init__(
        self,
        robot: Robot,
        config: MppiConfig | None = None,
        *,
        tick_s: float = 0.05,
        seed: int = 0,
    ) -> None:
        """Set up the controller.

        Args:
            robot: with its limits.
            config: by default `MppiConfig()`.
            tick_s: s between two commands.
            seed: of the disturbances; the same calls give the same commands.

        Raises:
            InvalidRequest: names `tick_s`.
        """
        self.robot, self.config = robot, config or MppiConfig()
        self.tick_s = number(tick_s, "tick_s", TICK)
        self._rng = np.random.default_rng(seed)

    def command(
        self,
        state: ArrayLike,
        *,
        cost_map: CostMap | Mapping[str, Any],
        goal: ArrayLike,
        anchors: AnchorBatch | Plan | None = None,
        obstacles: Obstacles | Mapping[str, Any] | None = None,
        speed_limit: float | None = None,
    ) -> Command:
        """Return the command for the tick that begins in a state.

        Args:
            state: [5] as `Robot` says for its kind, at the moment from which the command is held.
            cost_map: [C,H,W], in the frame of the state; beyond the map is as on its edge. Pass
                the same object while the map is the same, as what is made from it is kept.
            goal: [2] x, y, on the map or beyond it.
            anchors: those that begin at this state, or a planner's plan, which knows its age. A
                plan that is not usable means braking; None means MPPI alone.
            obstacles: what moves, seen at this moment.
            speed_limit: m/s, for this tick; None for the robot's v_max. A faster robot brakes.

        Raises:
            InvalidRequest: names the argument, what was expected and what came.
        """
        # A stand-in: it drives straight to the goal, and looks at nothing else.
        del cost_map, obstacles, anchors
        now = numbers(state, "state", COORDINATE, "[5]")
        if now.shape != (5,):
            raise wrong_shape("state", "[5]", now)
        target = numbers(goal, "goal", COORDINATE, "[2]")
        if target.shape != (2,):
            raise wrong_shape("goal", "[2]", target)
        most = (
            self.robot.v_max if speed_limit is None else number(speed_limit, "speed_limit", V_MAX)
        )
        u = self._straight(now, target, most)
        times = self.config.dt * np.arange(1, self.config.steps + 1)
        way = (
            u
            if self.robot.kind == "omni"
            else u[0] * np.array([math.cos(now[2]), math.sin(now[2])])
        )
        motion = np.column_stack([now[:2] + times[:, None] * way, np.full(len(times), now[2])])
        return Command(
            u=u,
            motion=motion,
            times=times,
            braking=False,
            cost=float(np.linalg.norm(target - motion[-1, :2])),
            kind=self.robot.kind,
            heading=float(now[2]),
        )

    def reset(self) -> None:
        """Drop the motion in progress: for another goal, or after a move by hand."""

    def _straight(
        self, now: NDArray[np.float64], target: NDArray[np.float64], most: float
    ) -> NDArray[np.float64]:
        robot, way = self.robot, target - now[:2]
        left = float(np.linalg.norm(way))
        speed = min(most, math.sqrt(robot.a_max * left))
        gain = robot.a_max * self.tick_s
        if robot.kind == "omni":
            change = speed * way / max(left, 1e-6) - now[3:]
            return now[3:] + change * min(1.0, gain / max(float(np.linalg.norm(change)), 1e-9))
        off = wrapped(math.atan2(way[1], way[0]) - now[2])
        v = now[3] + np.clip(speed * max(0.0, math.cos(off)) - now[3], -gain, gain)
        turn = float(np.clip(2.0 * off, -robot.omega_max, robot.omega_max))
        if robot.min_turning_radius > 0.0:
            turn = float(
                np.clip(turn, -abs(v) / robot.min_turning_radius, abs(v) / robot.min_turning_radius)
            )
        return np.array([v, turn])
