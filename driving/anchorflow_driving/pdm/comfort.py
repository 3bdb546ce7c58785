"""Whether a tracked motion is comfortable, as NAVSIM v1.1 smooths it."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from anchorflow_driving.log import FRAME_S
from anchorflow_driving.pdm.tracker import STEPS, Motion

Array = NDArray[np.float64]

BOUNDS = {
    "longitudinal_acceleration": (-4.05, 2.40),  # m/s²
    "lateral_acceleration": (-4.89, 4.89),
    "jerk": (-8.37, 8.37),  # m/s³, of the acceleration's size
    "longitudinal_jerk": (-4.13, 4.13),
    "yaw_acceleration": (-1.93, 1.93),  # rad/s²
    "yaw_rate": (-0.95, 0.95),  # rad/s
}
# Savitzky-Golay windows in samples: NAVSIM v1.1 passes the number of states for the window.
WHOLE, BEFORE_JERK, YAW = STEPS + 1, 8, 5


def comfort(motion: Motion) -> Array:
    """C [P]: 1 where every quantity keeps its bounds at every step."""
    score = np.ones(len(motion.poses), bool)
    for name, values in felt(motion).items():
        low, high = BOUNDS[name]
        score &= ((values > low) & (values < high)).all(-1)
    return score.astype(np.float64)


def felt(motion: Motion) -> dict[str, Array]:
    """What passengers feel, [P, T] by its name in BOUNDS."""
    forward, lateral = motion.acceleration, motion.speed * motion.yaw_rate
    heading = np.unwrap(motion.poses[..., 2], axis=-1)
    jerk = _smoother(BEFORE_JERK, 2, 0) @ _smoother(WHOLE, 2, 1)
    return {
        "longitudinal_acceleration": forward @ _smoother(WHOLE, 2, 0),
        "lateral_acceleration": lateral @ _smoother(WHOLE, 2, 0),
        "jerk": np.hypot(forward, lateral) @ jerk,
        "longitudinal_jerk": forward @ jerk,
        "yaw_acceleration": heading @ _smoother(YAW, 3, 2),
        "yaw_rate": heading @ _smoother(YAW, 2, 1),
    }


@cache
def _smoother(window: int, order: int, derivative: int) -> Array:
    """[T, T]: the filter is linear, so that it is what it makes of the unit rows."""
    unit = np.eye(STEPS + 1)
    smoothed = savgol_filter(unit, window, order, deriv=derivative, delta=FRAME_S, axis=-1)
    return np.asarray(smoothed, np.float64)
