"""When a path is where: a smooth law of speed along it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]

RAMP = 0.18


def time_along(
    path: FloatArray,
    num_samples: int,
    *,
    ramp: float = RAMP,
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
