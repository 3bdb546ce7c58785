"""The guard: which of N plans a car may follow, and the stop that takes the last place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.guard.faults import BOX, NONE, ROAD, TAKEN, Perceived, first_faults
from anchorflow_trajectory.guard.motion import FINE_S, Car, Legs
from anchorflow_trajectory.guard.stops import braking_after, stops_along
from anchorflow_trajectory.late import Departure

UNDRIVABLE = -1
"""What is wrong with a plan that no car can follow."""
PATHS = 8
"""Plans along whose paths stops are tried, the best first."""
CAUSES = {
    UNDRIVABLE: "cannot be driven from the present motion",
    ROAD: "leave the perceived road",
    BOX: "hit a perceived box",
    TAKEN: "drive where others are foretold",
}


@dataclass(frozen=True, eq=False)
class Verdict:
    """What is wrong with N plans [N], and the s from now [N] of the first time at which it is."""

    cause: NDArray[np.int64]
    time: FloatArray

    @property
    def safe(self) -> BoolArray:
        """[N]."""
        return self.cause == NONE

    def of(self, chosen: NDArray[np.intp]) -> Verdict:
        """Return that of some of the plans."""
        return Verdict(self.cause[chosen], self.time[chosen])


@dataclass(frozen=True, eq=False)
class Guard:
    """Judges plans in one scene.

    times: [T] s of their poses, from now or from the departure; speed: m/s now
    horizon_s: s for which a plan has to be clear of everything; then a stop has to be possible
    departure: where late plans begin; the way until then is judged too
    """

    times: FloatArray
    car: Car
    speed: float
    perceived: Perceived
    horizon_s: float
    departure: Departure | None = None

    def judge(self, plans: FloatArray) -> Verdict:
        """Judge plans [N,T,3]."""
        legs, horizon_s = self._legs(plans), self.horizon_s + self._delay_s
        motion = braking_after(legs.fine(self.speed, self.car), horizon_s)
        kind, step = first_faults(motion, self.car, self.perceived, horizon_s=horizon_s)
        undrivable = ~legs.can_be_driven(self.speed)
        return Verdict(
            np.where(undrivable, UNDRIVABLE, kind), np.where(undrivable, 0.0, FINE_S * step)
        )

    def with_stop(self, plans: FloatArray) -> tuple[Verdict, FloatArray, Verdict]:
        """Judge plans [N,T,3], the best first; return a stop [1,T,3] and what is wrong with it too.

        It is the gentlest of those along the paths of the first PATHS plans that are safe; if none
        is, the one that is safe longest.
        """
        speed = self.speed if self.departure is None else self.departure.speed
        stops = stops_along(self._legs(plans[:PATHS]), speed, self.times, late_s=self._delay_s)
        verdict = self.judge(np.concatenate([plans, stops]))
        of_stops = verdict.of(np.arange(len(plans), len(plans) + len(stops)))
        safe = of_stops.safe
        chosen = np.array([safe.argmax() if safe.any() else of_stops.time.argmax()])
        return verdict.of(np.arange(len(plans))), stops[chosen], of_stops.of(chosen)

    @property
    def _delay_s(self) -> float:
        return 0.0 if self.departure is None else self.departure.time

    def _legs(self, plans: FloatArray) -> Legs:
        if self.departure is None:
            return Legs.of(plans, self.times)
        begins = np.broadcast_to(self.departure.pose, (len(plans), 1, 3))
        times = self._delay_s + np.concatenate([[0.0], self.times])
        return Legs.of(np.concatenate([begins, plans], 1), times)


def told(verdict: Verdict) -> str:
    """Say in one sentence why no plan is safe; the last of them is the stop."""
    *_, last = causes = verdict.cause.tolist()
    counts = [
        f"{causes[:-1].count(cause)} {words}"
        for cause, words in CAUSES.items()
        if cause in causes[:-1]
    ]
    stop = f"a stop would {CAUSES[last]} after {verdict.time[-1]:.1f} s"
    if last == UNDRIVABLE:
        stop = "no stop can be driven from the present motion"
    proposals = f"of {len(causes) - 1} trajectories {', '.join(counts)}; " if counts else ""
    return f"no trajectory is safe: {proposals}{stop}"
