"""Progress: whether a robot that has a plan gets anywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLOWEST = 0.1  # share of v_max at which a robot that gets somewhere drives at least


class Progress:
    """Watches one robot; times are those of the planner's clock, in s."""

    def __init__(self, *, stuck_s: float, stuck_m: float) -> None:
        self._stuck_s, self._stuck_m = stuck_s, stuck_m
        self.reset()

    def reset(self) -> None:
        """The robot was carried, or has another goal."""
        self._left: Array | None = None
        self._since = 0.0

    def is_stuck(
        self, now: float, place: Array, goal: Array, *, driving: bool, v_max: float = np.inf
    ) -> bool:
        """Whether it has stayed about one place [2] in m, away from its goal, with a plan.

        v_max: m/s; a slow robot stays nearer to a place that it leaves than `stuck_m`.
        """
        about = min(self._stuck_m, SLOWEST * v_max * self._stuck_s)
        stays = self._left is not None and float(np.linalg.norm(place - self._left)) < about
        there = float(np.linalg.norm(goal - place)) < self._stuck_m
        if not stays or there or not driving:
            self._left, self._since = place, now
        return now - self._since >= self._stuck_s

    def next_step(self, now: float) -> None:
        """Something was tried against it: let that have its time."""
        self._since = now
