"""The sub-scores of the PDM score: collisions, drivable area, progress, TTC and comfort."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache

import numpy as np
from scipy.signal import savgol_filter

from anchorflow_driving.geometry import Array
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.pdm.collisions import Placement, no_collision, time_to_collision
from anchorflow_driving.pdm.lqr_rollout import STEPS, Motion
from anchorflow_driving.pdm.traffic import Traffic

FREE_PROGRESS = 5.0
"""m; progress counts only if some motion exceeds it."""
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
LANE_STRIDE = 2
"""Steps between two looks at the lanes."""
FREE_M, FADING_M = 2.0, 10.0
"""m against the lanes that cost nothing, and those in which compliance falls by e after them."""


@dataclass(frozen=True)
class PdmScores:
    """[P] each, in [0, 1]."""

    nc: Array  # no at-fault collision
    dac: Array  # drivable area compliance
    ep: Array  # ego progress
    ttc: Array  # time to collision
    c: Array  # comfort

    @property
    def pdms(self) -> Array:
        return self.nc * self.dac * (5 * self.ep + 5 * self.ttc + 2 * self.c) / 12

    @property
    def sub_scores(self) -> Array:
        """[P, 5] in the order of SUB_SCORES."""
        return np.stack([getattr(self, name) for name in SUB_SCORES], axis=-1)


SUB_SCORES = tuple(field.name for field in fields(PdmScores))
"""The order that every table of sub-scores [..., 5] has."""


@dataclass(frozen=True)
class Rating:
    """Scores, and what they were made of; [P]."""

    scores: PdmScores
    progress: Array  # m along the route x NC x DAC
    first_fault: Array  # step of the first at-fault collision, or inf


def rate(
    motion: Motion, traffic: Traffic, *, best: float | None = None, free: float = FREE_PROGRESS
) -> Rating:
    """Judges motions; progress against `best` (m x NC x DAC), or the best of the motions."""
    placement = Placement(motion, traffic.vehicle, traffic.road)
    nc, first_fault = no_collision(motion, traffic, placement)
    dac = np.where(placement.off_road.any(axis=-1), 0.0, 1.0)
    progress = _progress(motion, traffic) * nc * dac
    top = np.maximum(progress, progress.max() if best is None else best)
    ep = np.where(top > free, progress / np.maximum(top, free), 1.0)
    scores = PdmScores(
        nc=nc,
        dac=dac,
        ep=np.where(nc * dac > 0, ep, 0.0),
        ttc=time_to_collision(motion, traffic, placement),
        c=comfort(motion),
    )
    return Rating(scores, progress, first_fault)


def _progress(motion: Motion, traffic: Traffic) -> Array:
    """m [P] that the middle of the box goes along the route, not below 0."""
    middles = traffic.vehicle.middles(motion.poses[:, [0, -1]])
    arc_length, _ = traffic.route.project(middles[..., :2])
    return np.maximum(arc_length[:, 1] - arc_length[:, 0], 0.0)


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


def metres_against(motion: Motion, traffic: Traffic) -> Array:
    """Return the metres [P] that the box's middle drives in lanes that all lead the other way.

    NAVSIM v1.1 does not score this; v2 does, in steps (driving direction compliance; Cao et al.,
    2025, arXiv:2506.04218): 1 up to 2 m in a second, 0.5 up to 6 m, else 0.
    """
    middles = traffic.vehicle.middles(motion.poses[:, ::LANE_STRIDE])
    moved = np.linalg.norm(np.diff(middles[..., :2], axis=1), axis=-1)
    return (moved * traffic.road.against_lanes(middles[:, 1:])).sum(-1)


def direction_compliance(against: Array) -> Array:
    """Return the compliance in (0, 1] for metres against the lanes."""
    return np.exp(-np.maximum(against - FREE_M, 0.0) / FADING_M)
