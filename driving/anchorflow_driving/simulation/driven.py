"""A drive in reacting traffic: its motion, its progress along the route, and its log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import Array
from anchorflow_driving.log import (
    DRIVEN,
    FRAME_S,
    FUTURE_FRAMES,
    HISTORY_FRAMES,
    DrivingLog,
    track_fields,
    window_fields,
)
from anchorflow_driving.route import SPACING
from anchorflow_driving.window import EgoState
from anchorflow_trajectory.car.comfort import comfort
from anchorflow_trajectory.car.tracking import STEPS, Motion

if TYPE_CHECKING:
    from anchorflow_driving.simulation.sumo_traffic import LiveTraffic

STRIDE, STANDING_STRIDE = 10, 40
"""Frames between two windows at least, and where the ego stands."""
STANDING = 0.3  # m/s
OFF_ROUTE = 10.0
"""m beside the line, beyond which a vehicle drives elsewhere: two lanes and a half."""
BACK, ONWARDS = 5.0, 20.0
"""m of the line around the last place where the next one may be: a route may cross itself."""
QUANTITIES = ("poses", "speed", "acceleration", "yaw_rate")


class DrivenLog:
    """Notes frames and windows of a drive as they pass; the traffic's past frames begin the log."""

    def __init__(self, traffic: LiveTraffic, ego: str, map_fields: dict[str, Any]) -> None:
        self._traffic, self._ego, self._map_fields = traffic, ego, map_fields
        self._frames = traffic.past
        self._windows: list[tuple[int, Array, int, float]] = []

    def note_frame(self) -> None:
        """Note the frame after a step of the traffic."""
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
            **window_fields([ego] * len(kept), frame, command, limit, route),
            **track_fields(seen.kind, seen.size, states),
            **self._map_fields,
        )

    def _kept(self, states: NDArray[np.float32]) -> list[tuple[int, Array, int, float]]:
        """Select windows by the ego's states [F, 5]."""
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


class RouteProgress:
    """The place on a line of SPACING that is nearest to where a vehicle is, from `begin` m on.

    place: m from the line's first point
    aside: m from the line
    """

    def __init__(self, line: Array, *, begin: float) -> None:
        self._line, self._begin = line, begin
        self.place, self.aside = begin, 0.0

    @property
    def passed(self) -> float:
        """m of the route that are done."""
        return self.place - self._begin

    @property
    def is_lost(self) -> bool:
        """Whether the vehicle is not on its route any more."""
        return self.aside > OFF_ROUTE

    def advance(self, point: Array) -> None:
        """The vehicle is there now, [2]; from beside its route it does not get on."""
        low = max(round((self.place - BACK) / SPACING), 0)
        near = self._line[low : round((self.place + ONWARDS) / SPACING)]
        apart = np.linalg.norm(near - point, axis=1)
        self.aside = float(apart.min())
        if not self.is_lost:
            self.place = (low + int(apart.argmin())) * SPACING


def first_steps(motion: Motion, steps: int) -> Motion:
    """The motion's start and as many steps."""
    return _cut(motion, slice(0, steps + 1))


def rest_of(motion: Motion, steps: int) -> Motion:
    """The motion from a step on."""
    return _cut(motion, slice(steps, None))


def state_after(motion: Motion, step: int) -> EgoState:
    """How the only plan's vehicle moves after a step."""
    speed = float(motion.speed[0, step])
    return EgoState(
        pose=motion.poses[0, step],
        speed=max(speed, 0.0),
        acceleration=float(motion.acceleration[0, step]),
        curvature=float(motion.yaw_rate[0, step]) / speed if abs(speed) > 0.1 else 0.0,
    )


def joined(motions: list[Motion]) -> Motion:
    """Motions that each begin where the one before ends, as one."""
    parts = [motions[0], *(_cut(motion, slice(1, None)) for motion in motions[1:])]
    return Motion(*(np.concatenate([getattr(p, n) for p in parts], axis=1) for n in QUANTITIES))


def comfortable_stretches(driven: Motion) -> list[bool]:
    """Whether each stretch of 4 s is comfortable, one after the other; what is left over is judged
    with what was before it, as a stretch that ends with the drive. A shorter drive has none.
    """
    last = driven.speed.shape[1] - 1 - STEPS
    begins = sorted({*range(0, last + 1, STEPS), last} if last >= 0 else ())
    return [bool(comfort(_cut(driven, slice(b, b + STEPS + 1)))[0]) for b in begins]


def _cut(motion: Motion, steps: slice) -> Motion:
    return Motion(*(getattr(motion, name)[:, steps] for name in QUANTITIES))
