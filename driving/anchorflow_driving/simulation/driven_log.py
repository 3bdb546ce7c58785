"""A drive in traffic that reacts, as a log: what a driver meets where it has come to itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.line_fields import line_fields
from anchorflow_driving.log import DRIVEN, FRAME_S, FUTURE_FRAMES, HISTORY_FRAMES, DrivingLog
from anchorflow_driving.simulation.live_traffic import LiveTraffic

Array = NDArray[np.float64]

STRIDE, STANDING_STRIDE = 10, 40
"""Frames between two windows at least, and where the ego stands."""
STANDING = 0.3  # m/s


class DrivenLog:
    """Notes frames and windows of a drive as they pass.

    Args:
        traffic: stepped by somebody else; what it remembers is the log's beginning.
        ego: the vehicle that is driven.
        map_fields: of the log.
    """

    def __init__(self, traffic: LiveTraffic, ego: str, map_fields: dict[str, Any]) -> None:
        self._traffic, self._ego, self._map_fields = traffic, ego, map_fields
        self._frames = traffic.past
        self._windows: list[tuple[int, Array, int, float]] = []

    def note_frame(self) -> None:
        """What is now, after a step of the traffic."""
        self._frames.append(self._traffic.past[-1])

    def note_window(self, route: Array, command: int, speed_limit: float) -> None:
        """The driver is asked now."""
        self._windows.append((len(self._frames) - 1, route, command, speed_limit))

    def log(self, name: str) -> DrivingLog:
        """Windows are those with the ego for long enough before and after, no two too near."""
        seen = self._traffic.seen(self._frames)
        ego, states = seen.names.index(self._ego), seen.states.astype(np.float32)
        kept = self._kept(states[ego])
        frame, route, command, limit = zip(*kept, strict=True) if kept else ((), (), (), ())
        return DrivingLog(
            name=name,
            source=DRIVEN,
            licence="none",
            city="right-hand traffic",
            dt=FRAME_S,
            window_ego=np.full(len(kept), ego, np.int32),
            window_frame=np.array(frame, np.int32),
            window_command=np.array(command, np.uint8),
            window_speed_limit=np.array(limit, np.float32),
            **line_fields("route", list(route)),
            track_type=seen.kind,
            track_size=seen.size.astype(np.float32),
            track_state=states,
            **self._map_fields,
        )

    def _kept(self, states: NDArray[np.float32]) -> list[tuple[int, Array, int, float]]:
        """Of the windows, by the ego's states [F, 5]."""
        kept: list[tuple[int, Array, int, float]] = []
        for window in self._windows:
            first, last = window[0] - HISTORY_FRAMES, window[0] + FUTURE_FRAMES
            stands = np.hypot(*states[window[0], 3:]) < STANDING
            stride = STANDING_STRIDE if stands else STRIDE
            is_near = bool(kept) and window[0] - kept[-1][0] < stride
            if first < 0 or last >= len(states) or is_near:
                continue
            if np.isfinite(states[first : last + 1]).all():
                kept.append(window)
        return kept
