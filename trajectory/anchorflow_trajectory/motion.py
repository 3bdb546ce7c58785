"""Motion limits, and the smooth law of speed along a path that keeps them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled

TURN = 4.0 / 3.0  # m in which a robot without an acceleration limit reaches its speed smoothly
LEAST_RAMP = 0.12  # share of a duration; a spline cannot follow a steeper one
FAST, SPEEDS = 0.97, 20  # share of v_max in a hurry, and speeds tried
CRUISES = (0.5, 1.0, 11)  # the least share of v_max, the greatest, and how many are tried
QUICK, GENTLE = 0.7, 0.65  # shares of a_max while speeding up and while braking
LATE = 0.985, 0.9  # shares of v_max, and of a_max while speeding up, of who is late
CRUISE = 0.9  # share of v_max at pace 1: the bends of a spline overshoot


@dataclass(frozen=True)
class MotionLimits:
    """Limits of every anchor: speed [m/s] and acceleration [m/s^2].

    horizon_s: s that every anchor lasts; None if each has its own duration
    """

    v_max: float
    a_max: float
    horizon_s: float | None = None

    @property
    def jerk_scale(self) -> float:
        """Return the unit of jerk [m/s^3]: a ramp to v_max at a_max, or over TURN if gentler."""
        return min(self.a_max, self.v_max**2 / TURN) ** 2 / self.v_max

    def least_time(self, length: float) -> float:
        """Return the seconds from rest to rest along `length` m, at the limits."""
        if length * self.a_max > self.v_max**2:
            return length / self.v_max + self.v_max / self.a_max
        return 2.0 * (max(length, 0.0) / self.a_max) ** 0.5

    def most_way(
        self, duration: float, begin: float, end: float = 0.0, *, is_late: bool = False
    ) -> float:
        """Return about how many m can be covered smoothly in `duration` s, between two speeds.

        is_late: by one who goes nearer to the limits
        """
        (fast, quick), gentle = LATE if is_late else (FAST, QUICK), GENTLE
        quicker, slower = quick * self.a_max, gentle * self.a_max
        top = (duration + begin / quicker + end / slower) / (1.0 / quicker + 1.0 / slower)
        top = max(min(top, fast * self.v_max), end)
        rise, fall = (top - begin) / quicker, (top - end) / slower
        way = 0.5 * (top + begin) * rise + 0.5 * (top + end) * fall
        return way + top * max(duration - rise - fall, 0.0)

    def least_cruise(self, way: float, duration: float, begin: float, end: float) -> float:
        """Return the least speed [m/s] at which `way` m are covered in `duration` s; v_max at most.

        begin, end: m/s
        """
        for top in (self.v_max * np.linspace(*CRUISES)).tolist():
            limits = replace(self, v_max=top / FAST)
            if top >= max(begin, end) and limits.most_way(duration, begin, end) >= way:
                return top
        return self.v_max

    def least_speed(self, duration: float, begin: float) -> float:
        """Return the speed [m/s] to which smooth braking leads in `duration` s."""
        return max(begin - GENTLE * self.a_max * duration, 0.0)

    def speed_at(self, way: float, duration: float, begin: float) -> float:
        """Return the speed after `duration` s [m/s] of who is late and will rest after `way` m.

        It is 0 if that can be reached in time, and no more than can be reached.

        begin: m/s
        """
        least = self.least_speed(duration, begin)
        for end in np.linspace(least, FAST * self.v_max, SPEEDS).tolist():
            driven = self.most_way(duration, begin, end, is_late=True)
            if driven + end**2 / (2.0 * GENTLE * self.a_max) >= way:
                return end
        return FAST * self.v_max

    def durations(self, states: FloatArray) -> NDArray[np.float64]:
        """Return the durations [N] s of states [N, T, 3D + 1]: the horizon, or their own."""
        if self.horizon_s is not None:
            return np.full(len(states), self.horizon_s)
        return np.exp(states[..., -1].mean(-1, dtype=np.float64))


def nominal_duration(length: float, limits: MotionLimits, *, pace: float = 1.0) -> float:
    """Return the seconds along `length` m: a ramp to v_max at a_max, a cruise, and a ramp down.

    pace: factor by which the cruise is slower than the limits allow
    """
    cruise = CRUISE * limits.v_max / pace
    ramp = 0.5 * np.pi * cruise / limits.a_max
    if length < cruise * ramp:
        return 2.0 * pace * (0.5 * np.pi * max(length, 0.0) / limits.a_max) ** 0.5
    return length / cruise + ramp


def ramp_share(duration: float, length: float, limits: MotionLimits) -> float:
    """Return the share of a duration for each ramp of `time_along`; it keeps a_max if possible."""
    # A ramp r and the cruise v keep v (d - r) = length and π/2 v / r <= a_max.
    steep = 2.0 * np.pi * length / (limits.a_max * duration**2)
    return float(np.clip(0.5 * (1.0 - max(0.0, 1.0 - steep) ** 0.5), LEAST_RAMP, 0.5))


def time_along(
    path: FloatArray,
    num_samples: int,
    *,
    ramp: float,
    start_share: float = 0.0,
    goal_share: float = 0.0,
) -> FloatArray:
    """Return positions [T, 2] along a polyline [K, 2]: raised-cosine ramps around a cruise.

    ramp: share of the time from the first speed to the cruise's, and again to the last.
    start_share, goal_share: the speeds at both ends, in shares of the mean speed; if they leave
        no distance to the cruise, its speed is 0 and they are scaled down.
    """
    cruise = max(0.0, (1.0 - 0.5 * ramp * (start_share + goal_share)) / (1.0 - ramp))
    points = np.ascontiguousarray(path, np.float64)
    return _driven(
        points, num_samples, float(ramp), (float(start_share), cruise, float(goal_share))
    )


@compiled
def _driven(
    path: NDArray[np.float64], num_samples: int, ramp: float, speeds: tuple[float, float, float]
) -> NDArray[np.float32]:
    """Positions [T, 2] along a polyline [K, 2] at the speeds of start, cruise and goal."""
    start, cruise, goal = speeds
    speed, driven = np.empty(num_samples), np.zeros(num_samples)
    for k in range(num_samples):
        tau = k / (num_samples - 1)
        rise = 0.5 - 0.5 * np.cos(np.pi * min(min(tau, 1.0 - tau) / ramp, 1.0))
        first = start if tau < 0.5 else goal
        speed[k] = first + (cruise - first) * rise
        if k:
            driven[k] = driven[k - 1] + 0.5 * (speed[k] + speed[k - 1])
    marks = np.zeros(len(path))
    for leg in range(1, len(path)):
        step = path[leg] - path[leg - 1]
        marks[leg] = marks[leg - 1] + np.sqrt(step[0] ** 2 + step[1] ** 2)
    positions = np.empty((num_samples, 2), np.float32)
    for k in range(num_samples):
        at = driven[k] / driven[-1] * marks[-1]
        if at >= marks[-1]:
            positions[k, 0], positions[k, 1] = path[-1, 0], path[-1, 1]
            continue
        leg = np.searchsorted(marks, at, "right")
        share = (at - marks[leg - 1]) / (marks[leg] - marks[leg - 1])
        for axis in range(2):
            change = path[leg, axis] - path[leg - 1, axis]
            positions[k, axis] = path[leg - 1, axis] + share * change
    return positions


def share_within(velocity: FloatArray, gained: FloatArray, most: float) -> float:
    """The greatest share s of [0, 1] with |velocity + s gained| <= most; |velocity| is no more."""
    a, b = float(gained @ gained), float(velocity @ gained)
    room = max(most**2 - float(velocity @ velocity), 0.0)
    if a + 2 * b <= room:
        return 1.0
    return (-b + (b * b + a * room) ** 0.5) / a
