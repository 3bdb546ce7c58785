"""When a path is where: a smooth law of speed along it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost import MotionLimits

FloatArray = NDArray[np.floating]

LEAST_RAMP = 0.12  # share of a duration; a spline cannot follow a steeper one
CRUISE = 0.9  # share of v_max at pace 1: the bends of a spline overshoot


def nominal_duration(length: float, limits: MotionLimits, *, pace: float = 1.0) -> float:
    """s along a way of so many m: ramps up to v_max at a_max, a cruise, and down again.

    pace: by which the cruise is slower than the limits allow
    """
    cruise = CRUISE * limits.v_max / pace
    ramp = 0.5 * np.pi * cruise / limits.a_max
    if length < cruise * ramp:
        return 2.0 * pace * (0.5 * np.pi * max(length, 0.0) / limits.a_max) ** 0.5
    return length / cruise + ramp


def ramp_share(duration: float, length: float, limits: MotionLimits) -> float:
    """Share of a duration that each ramp of `time_along` takes, a_max kept if it can be."""
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
    """Positions [T, 2] along a polyline [K, 2]: raised-cosine ramps, and a cruise between them.

    ramp: share of the time spent from the first speed to the cruise's, and as much to the last.
    start_share, goal_share: the speeds at both ends, in shares of the mean speed; where they leave
        nothing to the cruise, it stands still and they are scaled down.
    """
    tau = np.linspace(0.0, 1.0, num_samples)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.clip(np.minimum(tau, 1.0 - tau) / ramp, 0.0, 1.0))
    cruise = max(0.0, (1.0 - 0.5 * ramp * (start_share + goal_share)) / (1.0 - ramp))
    first = np.where(tau < 0.5, start_share, goal_share)
    speed = first + (cruise - first) * rise
    along = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    marks = np.concatenate([[0.0], np.cumsum(steps)])
    at = along / along[-1] * marks[-1]
    return np.stack([np.interp(at, marks, path[:, k]) for k in (0, 1)], -1).astype(np.float32)
