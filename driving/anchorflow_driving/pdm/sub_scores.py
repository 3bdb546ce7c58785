"""The sub-scores of the PDM score: collisions, drivable area, progress, TTC and comfort."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from anchorflow_driving.geometry import Array
from anchorflow_driving.pdm.collisions import Placement, no_collision, time_to_collision
from anchorflow_driving.pdm.traffic import Traffic
from anchorflow_trajectory.car.comfort import comfort
from anchorflow_trajectory.car.tracking import Motion

FREE_PROGRESS = 5.0
"""m; progress counts only if some motion exceeds it."""
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
