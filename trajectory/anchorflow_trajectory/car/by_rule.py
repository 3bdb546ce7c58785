"""Where others may go by rule: on along their arcs, at their speed or braking."""

from __future__ import annotations

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.car.tracking import PLAN_TIMES

SLOWEST_TURN, SHARPEST_TURN = 1.0, 0.6
"""m/s up to which a turn is noise, and rad/s beyond which it is."""
BRAKES_HARD, HARD_CHANCE = 3.0, 0.1
"""m/s² and a chance that is added to what a network foresees: its modes brake less than some do."""


def arcs(
    now: FloatArray, velocity: FloatArray, turn_rate: FloatArray, *, braking: float = 0.0
) -> FloatArray:
    """Return futures [A,8,3] at PLAN_TIMES of others that go on along arcs.

    now: [A,3]; velocity: [A,2] m/s; turn_rate: [A] rad/s; braking: m/s², to a halt
    """
    speed = np.hypot(*velocity.T)[:, None]
    turn_rate = np.where(speed[:, 0] > SLOWEST_TURN, turn_rate, 0.0)[:, None]
    time = np.minimum(PLAN_TIMES, speed / max(braking, 1e-9))
    way = speed * time - braking / 2 * time**2
    turn = turn_rate.clip(-SHARPEST_TURN, SHARPEST_TURN) * way / np.maximum(speed, 1e-6)
    course = np.arctan2(velocity[:, 1], velocity[:, 0])[:, None] + turn / 2
    chord = way * np.sinc(turn / 2 / np.pi)
    moved = [chord * np.cos(course), chord * np.sin(course), turn]
    return now[:, None] + np.stack(moved, -1)
