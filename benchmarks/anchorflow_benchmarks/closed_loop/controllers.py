"""The controllers of a contest: what they have in common, and AnchorFlow's own behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_benchmarks.closed_loop.robots import DoubleIntegrator, Jackal, Robot
from anchorflow_client import CostMap
from anchorflow_client.planner import Plan
from anchorflow_control import MppiConfig, MppiController, Robot as ControlledRobot

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Sight:
    """What a robot knows of the world.

    occupied: [H, W], without the robot's own disc; resolution: m/cell; origin: [2] m
    surface: [H, W, 2] m, the obstacle's place in each occupied cell
    """

    occupied: NDArray[np.bool_]
    resolution: float
    origin: Array
    surface: Array


class Controller(Protocol):
    """Drives a robot of the simulation."""

    robot: Robot

    def command(
        self, state: Tensor, *, sight: Sight, goal: Array, plan: Plan | None = None
    ) -> tuple[Tensor, int | None]:
        """Return the control [U] for a state [X], and the index of the anchor it follows or None.

        goal: [2] m; plan: usable, or None without anchors
        """
        ...

    def rest(self) -> None:
        """Drop the motion in progress, so that the robot brakes."""
        ...

    def planned(self, state: Tensor) -> Array:
        """Return the places [T, 2] in m of the motion in progress after a state [X]."""
        ...


class AnchorController:
    """AnchorFlow's MPPI."""

    def __init__(self, robot: Robot, config: MppiConfig, *, tick_s: float, seed: int = 0) -> None:
        """tick_s: between two commands."""
        self.robot = robot
        self._tick_s = tick_s
        self._mppi = MppiController(controlled(robot), config, tick_s=tick_s, seed=seed)
        self._ahead = np.zeros((0, 2))

    def command(
        self, state: Tensor, *, sight: Sight, goal: Array, plan: Plan | None = None
    ) -> tuple[Tensor, int | None]:
        """Return the accelerations that give the commanded velocity within the tick."""
        own = state.double().numpy()
        if isinstance(self.robot, DoubleIntegrator):
            own = np.array([own[0], own[1], 0.0, own[2], own[3]])
        # Built without checks, as the map is new at each tick.
        cost_map = CostMap(
            np.asarray(sight.occupied[None], np.float32),
            sight.resolution,
            np.array(sight.origin, np.float64),
        )
        command = self._mppi.command(own, cost_map=cost_map, goal=goal, anchors=plan)
        self._ahead = command.motion[:, :2]
        control = (command.u - own[3:]) / self._tick_s
        return torch.tensor(control, dtype=torch.float32), command.anchor

    def rest(self) -> None:
        self._mppi.reset()
        self._ahead = np.zeros((0, 2))

    def planned(self, state: Tensor) -> Array:  # noqa: ARG002 the protocol's
        return self._ahead


def controlled(robot: Robot) -> ControlledRobot:
    """Return a robot of the simulation as the controller knows it."""
    if isinstance(robot, DoubleIntegrator):
        # The simulation limits each axis, the controller the size of both together.
        a_max = float(robot.control_limit[0])
        return ControlledRobot(kind="omni", v_max=robot.v_max, a_max=a_max, radius=robot.radius)
    return ControlledRobot(
        kind="differential",
        v_max=robot.v_max,
        a_max=robot.a_max,
        radius=None if isinstance(robot, Jackal) else robot.radius,
        footprint=robot.corners if isinstance(robot, Jackal) else None,
        omega_max=robot.yaw_rate_max,
        alpha_max=robot.yaw_acceleration_max,
        reverse=True,
        reverse_v_max=-robot.v_min,
    )
