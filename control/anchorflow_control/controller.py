"""Model predictive path integral control (Williams et al., 2017) that begins from anchors.

At each tick the motion in progress, braking, and motions along anchors are costed. The best of each
way round the obstacles is disturbed many times, and the weighted mean of that replaces it if it
costs less. The way in progress is left if another one is better by a margin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract import AnchorBatch, CostMap, Obstacles
from anchorflow_client.contract.checks import Interval, number, numbers, wrong_shape
from anchorflow_client.contract.ranges import COORDINATE, V_MAX
from anchorflow_client.planner import Plan
from anchorflow_control.anchor_motions import follow
from anchorflow_control.body import discs_of
from anchorflow_control.config import MppiConfig
from anchorflow_control.cost_to_go import WayLeft
from anchorflow_control.dynamics import Limits, brake, braking, step
from anchorflow_control.guides import Guides
from anchorflow_control.robot import Robot
from anchorflow_control.rollout import Motions, Task, Weights
from anchorflow_control.sampling import Disturbances, disturb, weigh
from anchorflow_control.surroundings import MapFields, movers_at
from anchorflow_control.ways import ways_of

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

TICK = Interval(0.0, 1.0, "s", open_low=True)
HELD, ENDED, BRAKING, STANDING = 0, 1, 2, 3  # motions without an anchor, and how many there are
PACES = np.array([1.0, 1.5, 2.25], np.float32)  # at which anchors are followed
WAYS = 3  # that are disturbed at a tick
RESERVE_S = 0.5  # beyond the time to stop, in which a motion must not collide
TOUCH = 1e-3  # m, by which a robot in contact may come nearer


@dataclass(frozen=True, kw_only=True, eq=False)
class Command:
    """The velocity to hold until the next tick, and the motion that it begins."""

    u: NDArray[np.float64]
    """[2], as `Robot` says: vx, vy in m/s in the map's frame, or v in m/s and w in rad/s."""
    motion: NDArray[np.float64]
    """[T,3], x and y in m and heading in rad of the predicted motion at `times`."""
    times: NDArray[np.float64]
    """[T] s from now."""
    braking: bool
    """Whether it is the hardest braking, for the `reason` below."""
    cost: float
    """The predicted motion's, by which the controller compares motions; lower is better."""
    reason: str | None = None
    """Why the robot brakes; None if it does not."""
    anchor: int | None = None
    """Index of the anchor that the motion follows; None if it follows none. For `Planner.follow`.
    """
    sideways: float | None = None
    """rad, the heading of a robot whose `u` is vx, vy; None for one that drives along its heading.
    """

    @property
    def twist(self) -> NDArray[np.float64]:
        """[3], vx, vy in m/s and turn rate in rad/s in the robot's own frame, as ROS's Twist."""
        if self.sideways is None:
            return np.array([self.u[0], 0.0, self.u[1]])
        cos, sin = np.cos(self.sideways), np.sin(self.sideways)
        x, y = self.u
        return np.array([cos * x + sin * y, cos * y - sin * x, 0.0])


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
        config = self.config
        self._discs = discs_of(robot)
        self._weights = Weights.of(config)
        self._times: Array = config.dt * np.arange(1, config.steps + 1, dtype=np.float64)
        self._noise = Disturbances(
            config.motions, config.steps, dt=config.dt, rng=np.random.default_rng(seed)
        )
        self._guides = Guides(config, tick_s=self.tick_s, discs=self._discs)
        self._fields: MapFields | None = None
        self.reset()

    def reset(self) -> None:
        """Drop the motion in progress: for another goal, or after a move by hand."""
        self._held = np.zeros((self.config.steps, 2), np.float32)
        self._ending = (0.0, 0.0)
        self._guides.reset()

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
                the same object while the map is the same, as its distance field is kept.
            goal: [2] x, y, on the map or beyond it.
            anchors: a planner's plan, which knows its age, or anchors, which are entered where the
                robot is. A plan that is not usable means braking; None means MPPI alone.
            obstacles: moving discs, observed at this moment.
            speed_limit: m/s, for this tick; None for the robot's v_max. A faster robot brakes.

        Raises:
            InvalidRequest: names the argument, what was expected and what came.
        """
        now = _vector(state, "state", 5)
        place = now[:2]
        limits = Limits.of(
            self.robot, None if speed_limit is None else number(speed_limit, "speed_limit", V_MAX)
        )
        moving = None if obstacles is None else Obstacles.from_fields(obstacles)
        speed = max(float(np.abs(now[3:]).sum()), self.robot.v_max)
        near = self.robot.reach + self.config.margin + self.config.comfort + speed * self._times
        movers = movers_at(moving, place, self._times, near=near)
        task = Task(
            limits=limits,
            start=np.array([0.0, 0.0, *now[2:]], np.float32),
            discs=self._discs,
            around=self._fields_of(cost_map).around(place, movers),
            weights=self._weights,
            dt=np.float32(self.config.dt),
            goal=(_vector(goal, "goal", 2) - place).astype(np.float32),
            left=WayLeft.straight(),
        )
        if isinstance(anchors, Plan) and not anchors.usable:
            self._guides.reset()
            return self._brake(task, now, str(anchors.reason))
        if isinstance(anchors, Plan) and anchors.stuck:
            self.reset()
        task, references, indices = self._guides.along(task, anchors, place)
        return self._best(task, now, references, indices)

    def _best(self, task: Task, now: Array, references: Floats, indices: list[int]) -> Command:
        """Return the command of the best motion; references: [A,S,5] along anchors."""
        tried = self._tried(task, references)
        of, starts = self._ways(task, tried)
        refined = self._refined(task, tried, starts)
        # Of each way what was tried, or its refinement.
        better = refined.costs < tried.costs[starts]
        costs = np.where(better, refined.costs, tried.costs[starts])
        costs[1:] += self.config.switch_cost
        way = int(costs.argmin())
        motions, k = (refined, way) if better[way] else (tried, starts[way])
        if (reason := self._unsafe(task, tried, motions, k)) is not None:
            return self._brake(task, now, reason)
        self._hold(task, motions, k)
        along = np.flatnonzero(of[STANDING:] == of[starts[way]])
        anchor = None
        if len(along):
            best = int(along[tried.costs[STANDING + along].argmin()])
            anchor = indices[best // len(PACES)]
        return self._command(task, now, motions, k, anchor=anchor)

    def _tried(self, task: Task, references: Floats) -> Motions:
        """Roll out the motion in progress, braking, and motions along anchors."""
        steps, share = self.config.steps, self.tick_s / self.config.dt
        count = STANDING + len(PACES) * len(references)
        controls = np.empty((count, steps, 2), np.float32)
        # The motion in progress, a tick later; then the robot keeps its velocity, or brakes.
        at = np.arange(steps) + share
        for i in range(2):
            for k, end in ((HELD, 0.0), (ENDED, self._ending[i])):
                held = np.append(self._held[:, i], np.float32(end))
                controls[k, :, i] = np.interp(at, np.arange(steps + 1), held)
        brake(task.limits, task.start, task.dt, controls[BRAKING])
        follow(task.limits, task.start, references, PACES, task.dt, controls[STANDING:])
        return Motions.under(task, controls)

    def _ways(self, task: Task, tried: Motions) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the way [K] of each motion, and the best motion [M] of each of the best ways.

        The first way is that in progress.
        """
        of = np.empty(len(tried.costs), np.int64)
        order = tried.costs.argsort()
        count = ways_of(task.around, tried.states, order, WAYS, of)
        starts = [np.where(of == way, tried.costs, np.inf).argmin() for way in range(count)]
        return of, np.array(starts)

    def _refined(self, task: Task, tried: Motions, starts: NDArray[np.int64]) -> Motions:
        """Return the weighted mean [M] of disturbed motions about each of some motions [M]."""
        config, scale = self.config, task.limits.control_scale
        count = max(config.motions - len(tried.costs) - len(starts), len(starts))
        controls = np.empty((count, config.steps, 2), np.float32)
        means = tried.controls[starts]
        noise = np.float32(config.noise) * scale
        disturb(means, self._noise.draw(count), noise, scale, controls)
        drawn = Motions.under(task, controls)
        weigh(drawn.costs, controls, np.float32(config.temperature), means)
        mean = Motions.under(task, means)
        # The mean of motions past both sides of a post is a bad motion: then the best one counts.
        best = [
            int(drawn.costs[way :: len(starts)].argmin()) * len(starts) + way
            for way in range(len(starts))
        ]
        failed = mean.costs > tried.costs[starts]
        return mean.replaced(failed, drawn, np.array(best))

    def _unsafe(self, task: Task, tried: Motions, motions: Motions, k: int) -> str | None:
        """Return why a motion cannot be begun, if it collides before the robot could stop."""
        floor = min(0.0, self._guides.start_room, float(tried.rooms[BRAKING, 0])) - TOUCH
        speed = np.hypot(*task.start[3:]) if self.robot.is_omni else abs(task.start[3])
        free_s = self.config.dt * motions.steps_clear(k, floor)
        if free_s > float(speed) / self.robot.a_max + RESERVE_S:
            return None
        return f"the best of {self.config.motions} motions collides in {free_s:.1f} s"

    def _brake(self, task: Task, now: Array, reason: str) -> Command:
        controls = np.empty((1, self.config.steps, 2), np.float32)
        brake(task.limits, task.start, task.dt, controls[0])
        controls[0, 0] = braking(task.limits, tuple(task.start), np.float32(self.tick_s))
        motions = Motions.under(task, controls)
        self._hold(task, motions, 0)
        return self._command(task, now, motions, 0, reason=reason)

    def _hold(self, task: Task, motions: Motions, k: int) -> None:
        """Keep a motion as that in progress."""
        self._held = motions.controls[k]
        self._ending = braking(task.limits, tuple(motions.states[k, -1]), task.dt)

    def _command(
        self,
        task: Task,
        now: Array,
        motions: Motions,
        k: int,
        *,
        reason: str | None = None,
        anchor: int | None = None,
    ) -> Command:
        first, second = motions.controls[k, 0]
        after = step(task.limits, tuple(task.start), first, second, np.float32(self.tick_s))
        motion = motions.states[k, :, :3].astype(np.float64)
        motion[:, :2] += now[:2]
        return Command(
            u=np.array(after[3:], np.float64),
            motion=motion,
            times=self._times,
            braking=reason is not None,
            cost=float(motions.costs[k]),
            reason=reason,
            anchor=anchor,
            sideways=float(now[2]) if self.robot.is_omni else None,
        )

    def _fields_of(self, cost_map: CostMap | Mapping[str, Any]) -> MapFields:
        """Return the fields of a map, kept while it is the same object."""
        if self._fields is None or self._fields.cost_map is not cost_map:
            if not isinstance(cost_map, CostMap):
                cost_map = CostMap.from_fields(cost_map)
            self._fields = MapFields(cost_map, self.config.cost_penalty)
        return self._fields


def _vector(value: ArrayLike, name: str, size: int) -> Array:
    vector = numbers(value, name, COORDINATE, f"[{size}]")
    if vector.shape != (size,):
        raise wrong_shape(name, f"[{size}]", vector)
    return vector
