"""Motion made of front bumpers: closed forms of the tractrix, and no slip of the rear axle."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_driving.geometry import ahead_of
from anchorflow_driving.simulation import LogConfig
from anchorflow_driving.simulation.vehicle_motion import (
    EVERY,
    STRIDE,
    deviating,
    person_states,
    vehicle_states,
)
from anchorflow_driving.window import REAR_AXLE, Scenes

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


SPEED = 8.0  # m/s


def straight(frames: int) -> np.ndarray:
    return np.stack([np.arange(frames) * SPEED / 10, np.full(frames, 3.0)], -1)


def test_windows_begin_aside_and_end_on_the_line() -> None:
    began, ended = [], []
    for seed in range(40):
        # Room for one deviation and its return.
        front, asked = deviating(straight(EVERY + 50), np.random.default_rng(seed), first=0)
        (frame,) = np.flatnonzero(asked)[:1]
        if frame + 45 < len(front) and asked.sum() == 1:
            began.append(abs(front[frame, 1] - 3.0))
            ended.append(abs(front[frame + 45, 1] - 3.0))

    assert len(began) > 10
    assert 0.3 < np.mean(began) < 1.5
    assert max(began) > 1.0
    assert max(ended) < 0.01


def test_windows_begin_at_other_speeds_but_nobody_drives_backwards() -> None:
    speeds = []
    for seed in range(40):
        front, asked = deviating(straight(200), np.random.default_rng(seed), first=0)
        moved = np.diff(front[:, 0]) * 10
        assert moved.min() >= -1e-9
        speeds += moved[np.flatnonzero(asked)].tolist()

    assert 0.3 < np.std(speeds) < 1.5
    assert np.mean(speeds) == pytest.approx(SPEED, abs=0.3)


def test_asked_frames_are_those_of_windows() -> None:
    for first in (-37, 0, 4):
        _, asked = deviating(straight(250), np.random.default_rng(1), first=first)
        frames = np.flatnonzero(asked) + first
        assert len(frames) >= 2
        assert not (frames % STRIDE).any()


def test_who_stands_is_not_moved() -> None:
    standing = np.repeat([[5.0, 1.0]], 150, axis=0)

    front, asked = deviating(standing, np.random.default_rng(0), first=0)

    np.testing.assert_array_equal(front, standing)
    assert not asked.any()


def test_who_stops_aside_stays_there() -> None:
    for seed in range(20):
        stops = np.concatenate([straight(90), np.repeat(straight(90)[-1:], 60, axis=0)])
        front, _ = deviating(stops, np.random.default_rng(seed), first=0)
        # A vehicle may still catch up along the line, and never slides sideways.
        still = np.abs(np.diff(front[:, 0])) < 1e-9
        assert np.abs(np.diff(front[:, 1]))[still].max() < 1e-9


def test_deviating_logs_ask_for_the_way_back() -> None:
    for module in ("sumo", "libsumo"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    from anchorflow_driving.simulation.simulated_log import simulate_log

    def asides(deviating: float) -> tuple[list[float], list[float]]:
        config = LogConfig(seed=3, seconds=16.0, windows=12, deviating=deviating)
        now, later = [], []
        for window in Scenes(simulate_log(config, 0)[0]):
            view, driven = window.view, window.recorded(np.array([4.0]))
            now.append(abs(view.route.project(np.zeros(2))[1]))
            later.append(abs(view.route.project(driven[0, :2])[1]))
        return now, later

    (plain, _), (now, later) = asides(0.0), asides(1.0)

    assert len(now) >= 4
    assert np.mean(now) > 1.5 * np.mean(plain)
    assert np.mean(later) < 0.75 * np.mean(now)
