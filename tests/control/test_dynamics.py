"""One step of a robot: its limits hold under any controls, and motions are those of its kind."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from anchorflow_control import Robot
from anchorflow_control.dynamics import Limits, brake, drive

DT = np.float32(0.1)
ROUNDING = 1e-4

CAR = Robot(
    kind="ackermann",
    v_max=1.0,
    a_max=1.5,
    radius=0.3,
    omega_max=1.2,
    min_turning_radius=0.6,
    reverse=True,
    reverse_v_max=0.5,
)
CART = Robot(kind="differential", v_max=1.0, a_max=0.8, radius=0.3, omega_max=2.0, alpha_max=3.0)
BALL = Robot(kind="omni", v_max=1.0, a_max=1.5, radius=0.3)

controls = st.lists(st.tuples(*[st.floats(-20.0, 20.0, width=32)] * 2), min_size=30, max_size=30)


def driven(robot: Robot, state: list[float], given: object) -> np.ndarray:
    """Return the states [T + 1, 5] under controls [T, 2]."""
    controls = np.asarray(given, np.float32)[None]
    start, states = np.array(state, np.float32), np.empty((1, controls.shape[1], 5), np.float32)
    drive(Limits.of(robot), start, DT, controls, states)
    return np.concatenate([start[None], states[0]]).astype(np.float64)


@settings(deadline=None, max_examples=60)
@given(controls)
@pytest.mark.parametrize("robot", [CAR, CART], ids=lambda robot: robot.kind)
def test_wheels_keep_every_limit(robot: Robot, controls: list) -> None:
    states = driven(robot, [0.0] * 5, controls)
    v, w = states[:, 3], states[:, 4]

    assert v.max() <= robot.v_max + ROUNDING
    assert v.min() >= robot.v_min - ROUNDING
    assert np.abs(np.diff(v)).max() <= robot.a_max * DT + ROUNDING
    assert np.abs(w).max() <= robot.omega_max + ROUNDING
    assert np.abs(v * w).max() <= robot.a_max + ROUNDING
    assert (robot.min_turning_radius * np.abs(w) <= np.abs(v) + ROUNDING).all()
    if robot is CART:
        # A car's turn rate falls faster where it brakes.
        bound = robot.alpha_max * DT + np.where(np.abs(v * w)[1:] > 0.99 * robot.a_max, 0.2, 0.0)
        assert (np.abs(np.diff(w)) <= bound + ROUNDING).all()


@settings(deadline=None, max_examples=60)
@given(controls)
def test_an_omni_robot_keeps_its_limits_in_every_direction(controls: list) -> None:
    velocity = driven(BALL, [0.0] * 5, controls)[:, 3:]

    assert np.linalg.norm(velocity, axis=1).max() <= BALL.v_max + ROUNDING
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() <= BALL.a_max * DT + ROUNDING


def test_a_circle_is_a_circle() -> None:
    states = driven(CART, [0.0, 0.0, 0.0, 0.8, 0.5], np.zeros((120, 2)))
    radius = np.linalg.norm(states[:, :2] - [0.0, 1.6], axis=1)
    np.testing.assert_allclose(radius, 1.6, atol=0.01)
    assert states[-1, 2] == pytest.approx(0.5 * 12.0, abs=1e-3)


def test_a_lower_speed_limit_is_reached_by_braking() -> None:
    robot, start = CART, np.array([0.0, 0.0, 0.0, 1.0, 0.0], np.float32)
    states = np.empty((1, 20, 5), np.float32)
    drive(Limits.of(robot, 0.3), start, DT, np.full((1, 20, 2), 9.0, np.float32), states)
    v = states[0, :, 3]

    np.testing.assert_allclose(np.diff(v[:8]), -robot.a_max * DT, atol=1e-5)
    np.testing.assert_allclose(v[10:], 0.3, atol=1e-6)


@pytest.mark.parametrize("robot", [CAR, CART, BALL], ids=lambda robot: robot.kind)
def test_braking_stops_as_soon_as_the_limit_allows(robot: Robot) -> None:
    state = [0.0, 0.0, 0.5, 0.6, 0.6] if robot is not BALL else [0.0, 0.0, 0.0, -0.6, 0.6]
    controls = np.empty((20, 2), np.float32)
    brake(Limits.of(robot), np.array(state, np.float32), DT, controls)
    states = driven(robot, state, controls)
    speed = np.linalg.norm(states[:, 3:], axis=1) if robot is BALL else states[:, 3]
    ticks = int(np.ceil(speed[0] / (robot.a_max * DT)))

    assert speed[ticks - 1] > 0.01
    np.testing.assert_allclose(states[ticks:, 3:], 0.0, atol=1e-5)
    if robot is not BALL:  # it stays on its bend
        turned, way = states[-1, 2] - 0.5, 0.5 * 0.6**2 / robot.a_max
        assert turned == pytest.approx(way * 0.6 / 0.6, rel=0.1)
