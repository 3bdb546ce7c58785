"""How robots move: one step of a state under accelerations, within the robot's limits.

States are x, y, heading and two velocities, as `Robot` says; controls are their accelerations.
Compiled loops work in float32, relative to the robot's place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.robot import Robot
from anchorflow_trajectory.compiled import compiled

Floats = NDArray[np.float32]

OMNI, WHEELS = 0, 1
NONE, HALF, SIXTH, TWO, ONE = map(np.float32, (0.0, 0.5, 1 / 6, 2.0, 1.0))
TINY = np.float32(1e-6)
SHARPEST = 1e4  # 1/m, the curvature of a turn on the spot


class Limits(NamedTuple):
    """A robot's limits as compiled loops read them.

    kind: OMNI or WHEELS; v_max: m/s, the speed limit of the tick included; curvature: 1/m
    """

    kind: int
    v_max: np.float32
    v_min: np.float32
    a_max: np.float32
    omega_max: np.float32
    alpha_max: np.float32
    curvature: np.float32

    @staticmethod
    def of(robot: Robot, speed_limit: float | None = None) -> Limits:
        """Return the limits at a tick; speed_limit: m/s, None for none."""
        most = robot.v_max if speed_limit is None else min(speed_limit, robot.v_max)
        sharpest = 1.0 / max(robot.min_turning_radius, 1.0 / SHARPEST)
        numbers = (most, max(robot.v_min, -most), robot.a_max, robot.omega_max, robot.alpha_max)
        kind = OMNI if robot.is_omni else WHEELS
        return Limits(kind, *map(np.float32, (*numbers, sharpest)))

    @property
    def control_scale(self) -> Floats:
        """[2], the largest size of each control."""
        second = self.a_max if self.kind == OMNI else self.alpha_max
        return np.array([self.a_max, second], np.float32)


@compiled
def within(value: np.float32, low: np.float32, high: np.float32) -> np.float32:
    """Return the value clipped to an interval; of an empty interval its upper end."""
    return min(max(value, low), high)


@compiled
def step(
    limits: Limits,
    state: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
    first: np.float32,
    second: np.float32,
    dt: np.float32,
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Return the state `dt` s later under two accelerations, both cut to the limits.

    Velocities change linearly, so that a long step ends where many short ones do.
    """
    if limits.kind == OMNI:
        return _omni_step(limits, state, first, second, dt)
    return _wheeled_step(limits, state, first, second, dt)


@compiled
def _omni_step(
    limits: Limits,
    state: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
    first: np.float32,
    second: np.float32,
    dt: np.float32,
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    x, y, heading, vx, vy = state
    to_x, to_y = vx + dt * first, vy + dt * second
    size = np.sqrt(to_x * to_x + to_y * to_y)
    if size > limits.v_max:
        to_x, to_y = to_x * (limits.v_max / size), to_y * (limits.v_max / size)
    # The limit of acceleration holds where the speed limit has just been lowered too.
    by_x, by_y, most = to_x - vx, to_y - vy, dt * limits.a_max
    size = np.sqrt(by_x * by_x + by_y * by_y)
    if size > most:
        by_x, by_y = by_x * (most / size), by_y * (most / size)
    x += dt * (vx + HALF * by_x)
    y += dt * (vy + HALF * by_y)
    return x, y, heading, vx + by_x, vy + by_y


@compiled
def _wheeled_step(
    limits: Limits,
    state: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
    first: np.float32,
    second: np.float32,
    dt: np.float32,
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    x, y, heading, v, w = state
    most = dt * limits.a_max
    to_v = within(v + dt * first, limits.v_min, limits.v_max)
    to_v = within(to_v, v - most, v + most)
    most = dt * limits.alpha_max
    to_w = within(w + dt * second, w - most, w + most)
    speed = abs(to_v)
    bound = min(limits.omega_max, limits.curvature * speed)
    if limits.curvature >= SHARPEST:
        bound = limits.omega_max
    if bound * speed > limits.a_max:
        bound = limits.a_max / speed
    to_w = within(to_w, -bound, bound)
    course, way = heading + dt * SIXTH * (TWO * w + to_w), HALF * dt * (v + to_v)
    x += way * np.cos(course)
    y += way * np.sin(course)
    return x, y, heading + HALF * dt * (w + to_w), to_v, to_w


@compiled
def braking(
    limits: Limits,
    state: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
    dt: np.float32,
) -> tuple[np.float32, np.float32]:
    """Return the controls of the hardest braking; robots on wheels keep their bend."""
    _, _, _, v, w = state
    if limits.kind == OMNI:
        size = np.sqrt(v * v + w * w)
        share = min(ONE, limits.a_max * dt / max(size, TINY)) / dt
        return -share * v, -share * w
    later = v - within(v, -limits.a_max * dt, limits.a_max * dt)
    turn = w * later / v if abs(v) > TINY else NONE
    return (later - v) / dt, (turn - w) / dt


@compiled
def drive(limits: Limits, start: Floats, dt: np.float32, controls: Floats, states: Floats) -> None:
    """Write the states [K,T,5] after each step from a state [5] on, under controls [K,T,2]."""
    for k in range(len(controls)):
        state = (start[0], start[1], start[2], start[3], start[4])
        for t in range(controls.shape[1]):
            state = step(limits, state, controls[k, t, 0], controls[k, t, 1], dt)
            states[k, t, 0], states[k, t, 1], states[k, t, 2] = state[0], state[1], state[2]
            states[k, t, 3], states[k, t, 4] = state[3], state[4]


@compiled
def brake(limits: Limits, start: Floats, dt: np.float32, controls: Floats) -> None:
    """Write the controls [T,2] of the hardest braking from a state [5]."""
    state = (start[0], start[1], start[2], start[3], start[4])
    for t in range(len(controls)):
        first, second = braking(limits, state, dt)
        controls[t, 0], controls[t, 1] = first, second
        state = step(limits, state, first, second, dt)
