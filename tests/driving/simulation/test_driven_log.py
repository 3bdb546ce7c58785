"""Drives as logs, of traffic that is made up."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

for _module in ("sumo", "libsumo"):
    pytest.importorskip(_module, reason=f"{_module} is not installed")

from anchorflow_driving.log import (  # noqa: E402
    HISTORY_FRAMES,
    VEHICLE,
    line_fields,
)
from anchorflow_driving.simulation.driven import DrivenLog  # noqa: E402
from anchorflow_driving.simulation.sumo_traffic import LiveTraffic  # noqa: E402

SQUARE = np.array([[-9.0, -9.0], [999.0, -9.0], [999.0, 9.0], [-9.0, 9.0]])
MAP = {
    **line_fields("lane", [SQUARE]),
    "lane_intersection": np.zeros(1, bool),
    "lane_edges": np.zeros((0, 2), np.int32),
    **line_fields("centre", [SQUARE[:2]]),
    **line_fields("drivable", [SQUARE]),
    **line_fields("crosswalk", []),
    **line_fields("line", []),
    "line_solid": np.zeros(0, bool),
}


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
