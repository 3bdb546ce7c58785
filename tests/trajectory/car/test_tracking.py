"""Rollouts of plans, and their comfort."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_driving.window import EgoState
from anchorflow_trajectory.car.comfort import BOUNDS, comfort, felt
from anchorflow_trajectory.car.tracking import Motion, interpolate, reference_profiles, track

TIME = np.arange(41, dtype=np.float64) * 0.1
WHEELBASE = 3.0


def at(speed: float, *, curvature: float = 0.0, acceleration: float = 0.0) -> EgoState:
    return EgoState(np.zeros(3), speed, acceleration, curvature)


def arc(speed: float, curvature: float) -> np.ndarray:
    turn = curvature * speed * TIME
    return np.stack([np.sin(turn), 1 - np.cos(turn), turn * curvature], -1)[None] / curvature


def accelerating(jerk: float) -> Motion:
    """A straight motion at a constant jerk, from and to moderate accelerations."""
    acceleration = jerk * (TIME - TIME.mean())
    speed = 20 + np.cumsum(acceleration) * 0.1
    poses = np.stack([np.cumsum(speed) * 0.1, 0 * TIME, 0 * TIME], -1)
    return Motion(poses[None], speed[None], acceleration[None], np.zeros((1, 41)))


def turning(rate: float) -> Motion:
    poses = np.stack([0 * TIME, 0 * TIME, rate * TIME], -1)
    return Motion(poses[None], *(np.full((1, 41), value) for value in (1.0, 0.0, rate)))


def test_poses_are_joined_by_straight_lines_the_shorter_way_round() -> None:
    poses = np.zeros((1, 9, 3))
    poses[0, :, 0] = np.arange(9) ** 2
    poses[0, 1::2, 2], poses[0, 0::2, 2] = 3.0, -3.0

    dense = interpolate(poses)

    np.testing.assert_allclose(dense[0, ::5, 0], np.arange(9) ** 2)
    assert dense[0, 7, 0] == pytest.approx(1 + 0.4 * 3)
    step = 2 * np.pi - 6
    np.testing.assert_allclose(dense[0, :5, 2], -3 - np.arange(5) / 5 * step)


def test_a_straight_line_at_its_own_speed_is_kept() -> None:
    reference = np.stack([7 * TIME, 0 * TIME, 0 * TIME], -1)[None]

    motion = track(reference, at(7.0), wheelbase=WHEELBASE)

    np.testing.assert_allclose(motion.poses, reference, atol=1e-9)
    np.testing.assert_allclose(motion.acceleration, 0, atol=1e-9)


def test_profiles_are_an_arcs_speed_and_curvature() -> None:
    speed, curvature = reference_profiles(arc(8.0, 0.05))

    # The chord of a step is shorter than its arc, and lies half a turn off the heading.
    np.testing.assert_allclose(speed, 8.0, rtol=1e-3)
    np.testing.assert_allclose(curvature, 0.05, rtol=1e-3)


@pytest.mark.parametrize("curvature", [0.05, -0.05])
def test_an_arc_is_followed(curvature: float) -> None:
    reference = arc(8.0, curvature)

    motion = track(reference, at(8.0, curvature=curvature), wheelbase=WHEELBASE)

    away = np.linalg.norm(motion.poses[..., :2] - reference[..., :2], axis=-1)
    assert away.max() < 0.5
    np.testing.assert_allclose(motion.yaw_rate, 8 * curvature, rtol=0.1)


def test_a_vehicle_that_is_to_stand_stops() -> None:
    motion = track(np.zeros((1, 41, 3)), at(2.0), wheelbase=WHEELBASE)

    assert abs(motion.speed[0, -1]) < 0.05
    np.testing.assert_array_equal(motion.poses[..., 1:], 0)


@pytest.mark.parametrize(("jerk", "expected"), [(1.2, 1), (-1.2, 1), (1.3, 0)])
def test_acceleration_keeps_its_bounds(jerk: float, expected: int) -> None:
    """±2 s of jerk reach 2.4 m/s² at 1.2: an order 2 filter keeps a straight line as it is."""
    motion = accelerating(jerk * 0.999)

    np.testing.assert_allclose(
        felt(motion)["longitudinal_acceleration"], motion.acceleration, atol=1e-9
    )
    assert comfort(motion) == [expected]


@pytest.mark.parametrize(("jerk", "expected"), [(3.9, True), (3.95, False), (-3.95, False)])
def test_jerk_keeps_its_bounds(jerk: float, expected: bool) -> None:
    """A window of 8 looks half a sample aside, but not at the ends: 5 % too much there."""
    low, high = BOUNDS["longitudinal_jerk"]
    found = felt(accelerating(jerk))["longitudinal_jerk"]

    np.testing.assert_allclose(found[:, [0, 20]], [[1.0507 * jerk, jerk]], rtol=1e-3)
    assert ((found > low) & (found < high)).all() == expected


@pytest.mark.parametrize(("rate", "expected"), [(0.94, 1), (-0.94, 1), (0.96, 0), (-0.96, 0)])
def test_turning_keeps_its_bounds(rate: float, expected: int) -> None:
    assert comfort(turning(rate)) == [expected]
