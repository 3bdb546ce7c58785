"""The sub-scores of motions in traffic."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.pdm.collisions import Placement, no_collision, time_to_collision
from anchorflow_driving.pdm.comfort import comfort
from anchorflow_driving.pdm.tracker import Motion
from anchorflow_driving.pdm.traffic import Traffic

Array = NDArray[np.float64]

FREE_PROGRESS = 5.0
"""m; where nobody gets farther, nobody is judged by it."""


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
