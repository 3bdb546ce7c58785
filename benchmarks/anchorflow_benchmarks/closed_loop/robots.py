"""Robots in torch, for the simulation and for MPPI's samples.

States [..., X] and controls [..., U] hold the fields named in each class. Robots have a disc of
`radius` m, or a rectangle of half its sides `half` [2] m with that disc in it, the limits `v_max`
m/s and `a_max` m/s^2, a lidar with a `field_of_view` in rad, and

    control_limit      [U], the largest size of each control
    start(pose)        state at rest at a pose [3]: x, y in m, yaw in rad
    step(state, control, dt)     state after dt s
    steer(state, carrot, speed, dt)     controls towards carrots [M, 2] m at speeds [M] m/s
    braking(state, dt) the control of the hardest braking
    speed(state)       m/s, negative backwards
    pose(state)        [3] of the lidar
    x_curr(state)      [6] position, velocity, acceleration of a request; [9] of poses
    room(world, state) m between the body and the nearest post, negative if they overlap
    options            fields of a request that describe the body
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import pi, tau
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_benchmarks.closed_loop.worlds import World

Array = NDArray[np.float64]

FULL_SPEED_TURN = 0.8  # rad off its course from which a unicycle turns on the spot
TURN_GAIN = 4.0  # 1/s, yaw rate per rad off course while it turns on the spot
SIDE_ACCELERATION = 2.0  # m/s^2 of a unicycle in a bend
BRAKING_SHARE = 0.5  # of a_max, for planned stops


@dataclass(frozen=True)
class Unicycle:
    """State x, y [m], yaw [rad], speed [m/s], yaw rate [rad/s]; control: their two accelerations.

    The default is BARN's Jackal as a disc, with the limits of the default bundle.
    """

    state_size: ClassVar[int] = 5
    half: ClassVar[tuple[float, float] | None] = None
    radius: float = 0.25
    v_max: float = 2.0
    v_min: float = -0.5
    yaw_rate_max: float = 2.5
    a_max: float = 3.0
    yaw_acceleration_max: float = 6.0
    field_of_view: float = 1.5 * pi

    @property
    def control_limit(self) -> Tensor:
        return torch.tensor([self.a_max, self.yaw_acceleration_max])

    def start(self, pose: Array) -> Tensor:
        return torch.tensor([*pose, 0.0, 0.0], dtype=torch.float32)

    def step(self, state: Tensor, control: Tensor, dt: float) -> Tensor:
        """Change both rates linearly, so that a long step ends where many short ones do."""
        x, y, yaw, speed, yaw_rate = state.unbind(-1)
        push, twist = control.unbind(-1)
        later = (speed + dt * push.clamp(-self.a_max, self.a_max)).clamp(self.v_min, self.v_max)
        twist = twist.clamp(-self.yaw_acceleration_max, self.yaw_acceleration_max)
        turning = (yaw_rate + dt * twist).clamp(-self.yaw_rate_max, self.yaw_rate_max)
        course, way = yaw + dt / 6 * (2 * yaw_rate + turning), 0.5 * dt * (speed + later)
        place = (x + way * torch.cos(course), y + way * torch.sin(course))
        return torch.stack([*place, yaw + 0.5 * dt * (yaw_rate + turning), later, turning], -1)

    def steer(self, state: Tensor, carrot: Tensor, speed: Tensor, dt: float) -> Tensor:
        """Follow by pure pursuit (Coulter, 1992); far off course turn on the spot."""
        way = carrot - state[:, :2]
        course = torch.atan2(way[:, 1], way[:, 0]) - state[:, 2]
        off = torch.remainder(course + pi, tau) - pi
        curvature = 2.0 * torch.sin(off) / way.norm(dim=1).clamp(min=0.05)
        bend_limit = (SIDE_ACCELERATION / (curvature.abs() + 1e-3)).sqrt()
        wanted = torch.minimum(speed, bend_limit) * torch.cos(off).clamp(min=0.0)
        on_the_spot = off.abs() > FULL_SPEED_TURN
        turn = torch.where(on_the_spot, TURN_GAIN * off, wanted * curvature + off)
        turn = turn.clamp(-self.yaw_rate_max, self.yaw_rate_max)
        control = torch.stack([wanted - state[:, 3], turn - state[:, 4]], -1) / dt
        return _within(control, self.control_limit)

    def braking(self, state: Tensor, dt: float) -> Tensor:
        return _within(-state[3:] / dt, self.control_limit)

    def speed(self, state: Tensor) -> Tensor:
        return state[..., 3]

    def pose(self, state: Tensor) -> Array:
        return state[:3].double().numpy()

    def x_curr(self, state: Tensor) -> Array:
        """Include the centripetal acceleration: an anchor without it would leave the bend."""
        x, y, yaw, speed, yaw_rate = state.double().numpy()
        along, aside = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        pull = np.clip(speed * yaw_rate, -self.a_max, self.a_max)
        return np.concatenate([[x, y], speed * along, pull * aside])

    def room(self, world: World, state: Tensor) -> float:
        return world.clearance(self.pose(state)[:2], self.radius)

    @property
    def options(self) -> dict[str, Any]:
        return {"robot_radius": self.radius}


@dataclass(frozen=True)
class Jackal(Unicycle):
    """The same with the rectangle that it is, 0.51 m long and 0.43 m wide."""

    half: ClassVar[tuple[float, float]] = (0.254, 0.215)
    radius: float = 0.215

    def x_curr(self, state: Tensor) -> Array:
        yaw, yaw_rate = state.double().numpy()[[2, 4]]
        flat = super().x_curr(state)
        return np.concatenate([flat[:2], [yaw], flat[2:4], [yaw_rate], flat[4:], [0.0]])

    def room(self, world: World, state: Tensor) -> float:
        return world.rectangle_clearance(self.pose(state), self.half)

    @property
    def corners(self) -> Array:
        """[4, 2] m of the outline."""
        return np.array(self.half) * [[1, 1], [-1, 1], [-1, -1], [1, -1]]

    @property
    def options(self) -> dict[str, Any]:
        drive = {"kind": "differential", "omega_max": self.yaw_rate_max, "reverse": True}
        return {
            "footprint": self.corners,
            "kinematics": drive,
            "goal_tolerance": {"position": 0.1, "heading": pi},
        }


@dataclass(frozen=True)
class DoubleIntegrator:
    """State x, y [m], vx, vy [m/s]; control: the acceleration. Its lidar sees all round."""

    state_size: ClassVar[int] = 4
    half: ClassVar[tuple[float, float] | None] = None
    radius: float = 0.25
    v_max: float = 2.0
    a_max: float = 3.0
    field_of_view: float = tau

    @property
    def control_limit(self) -> Tensor:
        # Along each axis, so that both together keep a_max.
        return torch.full((2,), self.a_max / 2**0.5)

    def start(self, pose: Array) -> Tensor:
        return torch.tensor([pose[0], pose[1], 0.0, 0.0], dtype=torch.float32)

    def step(self, state: Tensor, control: Tensor, dt: float) -> Tensor:
        velocity = state[..., 2:] + dt * _within(control, self.control_limit)
        size = velocity.norm(dim=-1, keepdim=True)
        velocity = velocity * (self.v_max / size.clamp(min=self.v_max))
        mean = 0.5 * (state[..., 2:] + velocity)
        return torch.cat([state[..., :2] + dt * mean, velocity], -1)

    def steer(self, state: Tensor, carrot: Tensor, speed: Tensor, dt: float) -> Tensor:
        way = carrot - state[:, :2]
        course = way / way.norm(dim=1, keepdim=True).clamp(min=0.05)
        return _within((speed[:, None] * course - state[:, 2:]) / dt, self.control_limit)

    def braking(self, state: Tensor, dt: float) -> Tensor:
        return _within(-state[2:] / dt, self.control_limit)

    def speed(self, state: Tensor) -> Tensor:
        return state[..., 2:].norm(dim=-1)

    def pose(self, state: Tensor) -> Array:
        return np.array([*state[:2].double().numpy(), 0.0])

    def x_curr(self, state: Tensor) -> Array:
        return np.array([*state.double().numpy(), 0.0, 0.0])

    def room(self, world: World, state: Tensor) -> float:
        return world.clearance(self.pose(state)[:2], self.radius)

    @property
    def options(self) -> dict[str, Any]:
        return {"robot_radius": self.radius}


Robot = Unicycle | DoubleIntegrator
ROBOTS: dict[str, Callable[[], Robot]] = {
    "unicycle": Unicycle,
    "jackal": Jackal,
    "jackal-disc": partial(Unicycle, radius=float(np.hypot(*Jackal.half))),
    "double-integrator": DoubleIntegrator,
}


def _within(control: Tensor, limit: Tensor) -> Tensor:
    return torch.maximum(torch.minimum(control, limit), -limit)
