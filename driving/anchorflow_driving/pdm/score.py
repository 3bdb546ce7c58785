"""PDMS = NC · DAC · (5·EP + 5·TTC + 2·C) / 12 of plans, tracked, among the recorded others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anchorflow_driving.geometry import Array, out_of_frame
from anchorflow_driving.pdm.pdm_closed import pdm_closed
from anchorflow_driving.pdm.sub_scores import SUB_SCORES, PdmScores, metres_against, rate
from anchorflow_driving.pdm.traffic import recorded_traffic
from anchorflow_driving.window import EgoState, Vehicle, Window
from anchorflow_trajectory.car.tracking import Motion, interpolate, track

__all__ = ["SUB_SCORES", "PdmScorer", "PdmScores"]


class PdmScorer:
    """Scores plans on one window; made once a window, as its reference is.

    The others replay the record and react to nothing.

    speed: m/s that the ego begins with instead of the recorded one
    progress: m along the route x NC x DAC of PDM-Closed, which EP is measured against
    """

    def __init__(self, window: Window, *, speed: float | None = None) -> None:
        self._traffic = recorded_traffic(window)
        if speed is not None:
            start = replace(self._traffic.start, speed=speed)
            self._traffic = replace(self._traffic, start=start)
        plan = pdm_closed(self._traffic.predicted())
        self.progress = float(rate(plan.motion, self._traffic).progress[0])

    def score(self, plans: Array) -> PdmScores:
        """Scores [P] of plans [P, 8, 3] at 0.5 … 4.0 s or [P, 40, 3] at 0.1 … 4.0 s.

        Poses (x, y, heading) of the rear axle in the ego's frame.

        Raises `ValueError` for another shape, or numbers that are not finite.
        """
        return self.judge(self.motion(plans))

    def judge(self, motion: Motion) -> PdmScores:
        """Scores [P] of what `motion` says is driven."""
        return rate(motion, self._traffic, best=self.progress).scores

    def metres_against(self, motion: Motion) -> Array:
        """[P] m of it in lanes that lead the other way; part of no score."""
        return metres_against(motion, self._traffic)

    def motion(self, plans: Array) -> Motion:
        """Roll out the plans, in the log's frame."""
        plans = np.asarray(plans, np.float64)
        if plans.ndim != 3 or plans.shape[1:] not in ((8, 3), (40, 3)):
            raise ValueError(f"plans: expected [P, 8, 3] or [P, 40, 3], got {list(plans.shape)}")
        if not np.isfinite(plans).all():
            raise ValueError("plans: expected finite numbers, got NaN or infinity")
        return tracked(plans, self._traffic.start, self._traffic.vehicle)


def tracked(plans: Array, start: EgoState, vehicle: Vehicle) -> Motion:
    """Roll out a vehicle that follows plans [P, 8, 3] or [P, 40, 3], in the frame of `start`."""
    poses = np.concatenate([np.zeros((len(plans), 1, 3)), plans], axis=1)
    reference = interpolate(out_of_frame(poses, start.pose))
    return track(reference, start, wheelbase=vehicle.wheelbase)
