"""Whether passengers find a motion comfortable, as nuPlan and NAVSIM judge it."""

from __future__ import annotations

from functools import cache
from math import factorial

import numpy as np

from anchorflow_trajectory.car.tracking import FRAME_S, STEPS, Array, Motion

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
    """Return the Savitzky-Golay filter [T, T]: the derivative of the polynomial of an order that
    fits a window of samples, at the window's middle, and at the ends where the whole window lies.
    """
    half, count = window // 2, STEPS + 1
    smoother = np.zeros((count, count))
    for row in range(count):
        begin = min(max(row - half, 0), count - window)
        at = row - begin
        if half <= row < count - half:
            begin, at = row - (window - 1) // 2, (window - 1) / 2
        powers = np.vander((np.arange(window) - at) * FRAME_S, order + 1, increasing=True)
        fit = np.linalg.pinv(powers)[derivative] * factorial(derivative)
        smoother[begin : begin + window, row] = fit
    return smoother
