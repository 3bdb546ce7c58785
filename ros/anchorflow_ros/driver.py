"""The node's decisions without ROS: it reads messages and returns a command at every tick.

    driver = Driver(settings, client)
    driver.inputs.on_odometry(message)  # and the other messages, as they arrive
    decision = driver.tick(now, steady=steady)  # the twist to publish, and what is wrong

A message that cannot be read, data that are too old, a clock that jumps and a service that is
away all end in braking and in a `Fault` that names the part and the reason.
"""

from __future__ import annotations

import math
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.planner import AnchorSource, Plan, Planner
from anchorflow_client.planner.request import at_the_state
from anchorflow_control import MppiController, Robot
from anchorflow_ros.faults import ERROR, OK, WARN, ClockWatch, Fault, Stopped
from anchorflow_ros.frames import Frames, StaticFrames
from anchorflow_ros.inputs import Goal
from anchorflow_ros.parameters import Settings
from anchorflow_ros.scene import Scene, SceneReader

Array = NDArray[np.float64]

LEFT = 2.0
"""Times the goal's tolerance, beyond which a robot that had arrived has been moved away."""
SLOWEST = 0.3
"""m/s; anchors are planned for no lower limit, the controller drives as slowly as it has to."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Decision:
    """What to publish at a tick."""

    twist: Array
    """[3] forward and left in m/s, turn rate in rad/s, in the robot's frame."""
    braking: bool
    idle: bool = False
    """There is no goal, or the robot has arrived at it."""
    faults: tuple[Fault, ...]
    """The reason for braking first; empty if all is well."""
    frame_id: str = ""
    """The frame of the plan and the motion."""
    plan: Plan | None = None
    starts_at: float = 0.0
    """s, the moment at which the plan's anchors start."""
    motion: Array | None = None
    """[T,3] x, y, heading that the controller predicts."""


class Driver:
    """Drives one robot; every method is for the one thread of the node."""

    def __init__(
        self,
        settings: Settings,
        client: AnchorSource,
        *,
        frames: Frames | None = None,
        executor: Executor | None = None,
    ) -> None:
        """Set up planner and controller.

        Args:
            settings: the node's parameters.
            client: answers requests, in its own time.
            frames: transforms; by default the parameter's alone.
            executor: runs the requests, as in `Planner`.
        """
        self.settings = settings
        self.inputs = SceneReader(settings, frames or StaticFrames(settings.transforms))
        self.planner = Planner(client, settings.planner, clock=lambda: self._now, executor=executor)
        self._controller = self._controller_of(settings.robot)
        self._clock = ClockWatch(settings["clock.jump_s"], settings["clock.stands_s"])
        self._now = 0.0
        self._goal: Goal | None = None
        self._arrived, self._sent = False, 0
        self._twist = np.zeros(3)
        self._answer: str | None = None
        self._answered_at: float | None = None

    def close(self) -> None:
        self.planner.close()

    def tick(self, now: float, *, steady: float) -> Decision:
        """Return what to do until the next tick.

        Args:
            now: s on the clock of the messages' stamps.
            steady: s on a clock that never jumps.
        """
        try:
            self._watch_clock(now, steady)
            self._take_goal()
            if self._goal is None and "goal" not in self.inputs.refused:
                return self._brake(Fault("goal", OK, "none"), idle=True)
            scene = self.inputs.scene(now)
            if self._has_arrived(scene.goal_distance):
                return self._brake(Fault("goal", OK, "arrived"), idle=True)
            return self._drive(scene, now)
        except Stopped as stopped:
            return self._brake(stopped.fault)

    def _watch_clock(self, now: float, steady: float) -> None:
        """Set the planner's clock; forget what is old if it jumps. Raises `Stopped`."""
        jump_s = self._clock.jump(now, steady)
        self._now = now
        if jump_s:
            self._forget_plan()
            self.inputs.begin_anew(now)
            raise Stopped("clock", f"it jumped by {jump_s:+.2f} s; everything begins anew")
        self._clock.check()

    def _take_goal(self) -> None:
        if self._goal is not self.inputs.goal:
            self._goal, self._arrived = self.inputs.goal, False
            self._forget_plan()

    def _has_arrived(self, away: float) -> bool:
        """Whether the robot was `away` m or less from its goal since it was sent.

        The same goal, sent again, starts a robot that has been moved away from it.
        """
        tolerance, sent = self.settings["goal.tolerance"], self.inputs.goals_sent
        if away <= tolerance:
            self._arrived, self._sent = True, sent
        elif self._arrived and sent > self._sent and away > LEFT * tolerance:
            self._arrived = False
            self._forget_plan()
        return self._arrived

    def _drive(self, scene: Scene, now: float) -> Decision:
        if self._controller.robot is not self.inputs.robot:
            self._controller = self._controller_of(self.inputs.robot)
        plan = self._plan(scene, now)
        lead_s = self.settings["service.lead_s"]
        about = {
            "plan": plan,
            "starts_at": now - 1e-3 * plan.age_ms + lead_s,
            "frame_id": scene.frame_id,
        }
        if (silent := self._silence(plan, now)) is not None:
            return self._brake(silent, **about)
        moving = scene.obstacles
        command = self._controller.command(
            self._state_of(scene),
            cost_map=scene.cost_map,
            goal=[scene.goal.x, scene.goal.y],
            anchors=replace(plan, age_ms=max(0.0, plan.age_ms - 1e3 * lead_s)),
            obstacles=None if moving is None else at_the_state(moving, scene.obstacles_age_s),
            speed_limit=self.inputs.speed_limit,
        )
        if command.anchor is not None:
            self.planner.follow(command.anchor)
        self._twist = command.twist
        faults = []
        if command.braking:
            faults.append(Fault("controller", WARN, command.reason or "it brakes"))
        if plan.reason is not None:
            faults.append(Fault("service", WARN, plan.reason))
        return Decision(
            twist=command.twist,
            braking=command.braking,
            faults=(*faults, *self.inputs.warnings()),
            motion=command.motion,
            **about,
        )

    def _state_of(self, scene: Scene) -> Array:
        """Return the controller's state [5], in which the robot will be when it obeys."""
        motion = scene.motion.after(self.settings["robot.delay_s"], self._twist)
        pose = motion.pose
        omni = self._controller.robot.is_omni
        rates = motion.velocity if omni else motion.twist[[0, 2]]
        return np.array([pose.x, pose.y, pose.yaw, *rates])

    def _plan(self, scene: Scene, now: float) -> Plan:
        """Pass the scene to the planner, from where the robot will be at the answer's arrival."""
        settings, robot = self.settings, self.inputs.robot
        poses, lead_s = settings["robot.plan_poses"], settings["service.lead_s"]
        poses = poses and not robot.is_omni
        motion = scene.motion.after(lead_s, self._twist)
        goal = [scene.goal.x, scene.goal.y, *([scene.goal.yaw] if poses else [])]
        body = robot.options if poses else {"a_max": robot.a_max, "robot_radius": robot.reach}
        body["v_max"] = robot.v_max
        if (limit := self.inputs.speed_limit) is not None:
            body["v_max"] = min(robot.v_max, max(limit, motion.speed, SLOWEST))
        plan = self.planner.update(
            cost_map=scene.cost_map,
            x_curr=motion.x_curr(a_max=robot.a_max, with_heading=poses),
            x_goal=[*goal, *(0.0 for _ in goal)],
            obstacles=scene.obstacles,
            obstacles_age_s=scene.obstacles_age_s + lead_s,
            **body,
            **settings.options,
        )
        if self._answered_at is None or plan.request_id != self._answer:
            self._answer, self._answered_at = plan.request_id, now
        return plan

    def _silence(self, plan: Plan, now: float) -> Fault | None:
        """Return why there is nothing to follow, if the service is away or has not answered yet."""
        assert self._answered_at is not None  # since the first request
        silence = now - self._answered_at
        late = silence > self.settings["service.silence_s"]
        why = "" if plan.last_error is None else f": {plan.last_error}"
        if late:
            return Fault("service", ERROR, f"no answer for {silence:.2f} s{why}")
        if not plan.usable:
            level = WARN if plan.last_error is None else ERROR
            return Fault("service", level, f"{plan.reason}{why}")
        return None

    def _brake(self, fault: Fault, **about: Any) -> Decision:
        """Return the command that slows down from the last one as fast as the robot may."""
        self._controller.reset()
        self._twist = braked(self._twist, self.inputs.robot, self.settings.tick_s)
        others = (each for each in self.inputs.warnings() if each.part != fault.part)
        return Decision(twist=self._twist, braking=True, faults=(fault, *others), **about)

    def _controller_of(self, robot: Robot) -> MppiController:
        return MppiController(robot, self.settings.controller, tick_s=self.settings.tick_s)

    def _forget_plan(self) -> None:
        self.planner.reset()
        self._controller.reset()
        self._answer = self._answered_at = None


def braked(twist: Array, robot: Robot, tick_s: float) -> Array:
    """Return the next twist [3] of the hardest braking: along the same arc, or on the spot."""
    speed = math.hypot(*twist[:2])
    if speed > 0.0:
        return twist * max(1.0 - robot.a_max * tick_s / speed, 0.0)
    turn = max(abs(twist[2]) - robot.alpha_max * tick_s, 0.0)
    return np.array([0.0, 0.0, math.copysign(turn, twist[2])])
