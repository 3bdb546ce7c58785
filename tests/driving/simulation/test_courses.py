"""Motion made of front bumpers: closed forms of the tractrix, and no slip of the rear axle."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_driving.geometry import ahead_of
from anchorflow_driving.simulation.vehicle_motion import person_states, vehicle_states
from anchorflow_driving.window import REAR_AXLE

LENGTH = 5.0
ARM = REAR_AXLE * LENGTH


def test_straight_on_the_middle_is_half_a_length_behind_the_front() -> None:
    front = np.stack([np.arange(60) * 0.8, np.full(60, 3.0)], -1)

    states = vehicle_states(front, LENGTH)

    np.testing.assert_allclose(states[:, 0], front[:, 0] - LENGTH / 2, atol=1e-6)
    np.testing.assert_allclose(states[:, 1:3], [[3.0, 0.0]] * 60, atol=1e-6)
    np.testing.assert_allclose(states[:, 3:], [[8.0, 0.0]] * 60, atol=1e-6)


def test_on_a_circle_the_arm_settles_at_its_angle() -> None:
    radius, turn = 20.0, np.arange(200) * 0.03
    front = radius * np.stack([np.cos(turn), np.sin(turn)], -1)

    states = vehicle_states(front, LENGTH)

    x, y, heading = states[150, :3]
    slip = np.arctan2(y, x) + np.pi / 2 - heading
    # The arm is a chord's tangent: sin(slip) = arm / radius, and the axle's course is its own.
    assert np.sin(slip) == pytest.approx(ARM / np.hypot(x, y), rel=0.01)


def test_the_rear_axle_does_not_slip_round_a_corner() -> None:
    corner = np.concatenate(
        [np.linspace([0.0, 0.0], [30.0, 0.0], 40), np.linspace([30.0, 0.7], [30, 30], 40)]
    )

    states = vehicle_states(corner, LENGTH)

    axle = ahead_of(states[:, :3], -ARM)
    step = np.diff(axle[5:-5, :2], axis=0)
    between = (states[5:-6, 2] + states[6:-5, 2]) / 2
    sideways = step[:, 1] * np.cos(between) - step[:, 0] * np.sin(between)
    assert np.abs(sideways).max() < 0.03  # m in 0.1 s, at 7.5 m/s
    assert states[-1, 2] == pytest.approx(np.pi / 2, abs=0.02)


def test_who_stands_stays_where_it_is() -> None:
    front = np.array([[0.0, 0.0], *([[0.5, 0.0]] * 60)])

    states = vehicle_states(front, LENGTH)

    assert np.ptp(states[30:, :3], axis=0) == pytest.approx([0.0, 0.0, 0.0])
    assert not states[30:, 3:].any()


def test_a_walker_faces_where_it_goes() -> None:
    walked = np.linspace([0.0, 0.0], [0.0, 4.68], 40)

    states = person_states(walked)

    np.testing.assert_allclose(states[:, 2], np.pi / 2, atol=1e-6)
    np.testing.assert_allclose(states[:, 4], 1.2, atol=1e-6)
