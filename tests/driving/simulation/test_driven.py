"""A drive: its log, the comfort of its motion, and its progress along the route."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from driven_bend import one_lane

from anchorflow_driving.log import HISTORY_FRAMES, VEHICLE
from anchorflow_driving.route import SPACING
from anchorflow_driving.simulation.driven import (
    QUANTITIES,
    RouteProgress,
    comfortable_stretches,
    first_steps,
    joined,
)
from anchorflow_trajectory.car.tracking import Motion

for _module in ("sumo", "libsumo"):
    pytest.importorskip(_module, reason=f"{_module} is not installed")

from anchorflow_driving.simulation.driven import DrivenLog  # noqa: E402
from anchorflow_driving.simulation.sumo_traffic import LiveTraffic  # noqa: E402

SQUARE = np.array([[-9.0, -9.0], [999.0, -9.0], [999.0, 9.0], [-9.0, 9.0]])
MAP = one_lane(SQUARE, SQUARE[:2])


class MadeUp(LiveTraffic):
    """Without SUMO: the ego at 5 m/s from some frame on, and one that stands until another."""

    def __init__(self, *, appears: int, leaves: int) -> None:
        self.appears, self.leaves = appears, leaves
        self._standing, self._past = [], deque(maxlen=HISTORY_FRAMES + 1)
        self._size = {"ego": (4.0, 1.8), "another": (8.0, 2.5)}
        self._kind = dict.fromkeys(self._size, VEHICLE)
        for frame in range(HISTORY_FRAMES + 1):
            self.pass_(frame)

    def pass_(self, frame: int) -> None:
        there: dict[str, np.ndarray] = {}
        if frame >= self.appears:
            there["ego"] = np.array([0.5 * frame, 0.0, 0.0, 5.0, 0.0])
        if frame < self.leaves:
            there["another"] = np.array([50.0, 0.0, 3.0, 0.0, 0.0])
        self._past.append(there)


def test_windows_are_those_with_the_ego_for_long_enough() -> None:
    traffic = MadeUp(appears=7, leaves=60)
    noted = DrivenLog(traffic, "ego", MAP)
    for frame in range(20, 101):
        if frame % 5 == 0:
            noted.note_window(np.array([[0.0, 0.0], [200.0, 0.0]]), 1, 13.9)
        traffic.pass_(frame + 1)
        noted.note_frame()

    log = noted.log("made up")

    # Frames 0 to 101; seen from 7 on, with 20 before and 45 after, a second apart.
    assert log.window_frame.tolist() == [30, 40, 50]
    assert log.track_state.shape == (2, 102, 5)
    ego = log.window_ego[0]
    assert np.isnan(log.track_state[ego, :7]).all()
    np.testing.assert_allclose(log.track_state[ego, 7:, 0], 0.5 * np.arange(7, 102))
    assert np.isfinite(log.track_state[1 - ego, :60]).all()
    assert np.isnan(log.track_state[1 - ego, 60:]).all()
    np.testing.assert_allclose(log.track_size[[ego, 1 - ego]], [[4.0, 1.8], [8.0, 2.5]])
    assert log.route(0).tolist() == [[0.0, 0.0], [200.0, 0.0]]


def braking(seconds: float, *, since: float) -> Motion:
    """Straight on at 20 m/s, and from a time on with 9 m/s²."""
    time = np.arange(round(seconds * 10) + 1) / 10
    acceleration = np.where(time >= since, -9.0, 0.0)[None]
    speed = np.maximum(20.0 + 0.1 * np.cumsum(acceleration, 1), 0.0)
    x = 0.1 * np.cumsum(speed, 1)
    return Motion(np.stack([x, 0 * x, 0 * x], -1), speed, acceleration, 0 * speed)


@pytest.mark.parametrize(
    ("seconds", "since", "wanted"),
    [
        (4.0, 9.0, [True]),
        (4.0, 0.0, [False]),
        (8.0, 4.5, [True, False]),
        (9.0, 8.0, [True, True, False]),
        (3.9, 0.0, []),
    ],
)
def test_stretches(seconds: float, since: float, wanted: list[bool]) -> None:
    assert comfortable_stretches(braking(seconds, since=since)) == wanted


def test_motions_join_where_one_ends_and_the_next_begins() -> None:
    whole = braking(2.0, since=1.0)
    parts = [Motion(*(getattr(whole, name)[:, 5 * k :] for name in QUANTITIES)) for k in range(4)]
    again = joined([first_steps(part, 5) for part in parts])
    np.testing.assert_array_equal(again.poses, whole.poses)
    np.testing.assert_array_equal(again.speed, whole.speed)


def straight(length: float) -> np.ndarray:
    x = np.arange(0.0, length, SPACING)
    return np.stack([x, 0 * x], -1)


def test_who_follows_it_gets_on() -> None:
    progress = RouteProgress(straight(200.0), begin=20.0)
    for x in range(20, 121, 5):
        progress.advance(np.array([x, 3.0]))
    assert (progress.passed, progress.aside, progress.is_lost) == (100.0, 3.0, False)


def test_a_street_beside_it_is_no_part_of_it() -> None:
    progress = RouteProgress(straight(200.0), begin=20.0)
    for x in range(20, 121, 5):
        progress.advance(np.array([x, min(x - 20.0, 40.0)]))
    assert progress.is_lost
    assert progress.passed == pytest.approx(10.0)


def test_a_crossing_with_itself_is_no_short_cut() -> None:
    out, back = straight(100.0), straight(100.0)[::-1] + np.array([0.0, 1.0])
    progress = RouteProgress(np.concatenate([out, back]), begin=20.0)
    progress.advance(np.array([25.0, 0.9]))
    assert progress.passed == pytest.approx(5.0)
