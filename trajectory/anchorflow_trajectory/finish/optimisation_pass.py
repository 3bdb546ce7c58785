"""One pass of the finish in one compiled call: slow down, descend, speed up, and check safety.

The call releases the interpreter's lock throughout. Threads may run ranges of the anchors: each
anchor is computed on its own, so its bytes do not depend on the split.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.cost.kernels import Problem, cost_of_lanes
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.finish.certificate import Judge, is_safe
from anchorflow_trajectory.finish.descent import Descent, descend_lanes
from anchorflow_trajectory.spline.basis import Ends, Splines
from anchorflow_trajectory.spline.kernels import (
    LANES,
    Band,
    EndPoints,
    copy_lane,
    put_lanes,
    sample_lanes,
    set_lanes_ends,
    take_lanes,
)
from anchorflow_trajectory.threads import Spread, in_one

MOST_STRETCH = 3.0


@dataclass(frozen=True)
class OptimisationPass:
    """The settings of a pass; durations are fixed if the limits have a horizon.

    steps, rate: of the descent, as in `descend`
    slowed_before, slowed_after: stretch trajectories that exceed a limit before or after it
    shares: fractions of the duration to try after it; the cheapest is kept
    """

    steps: int
    rate: float
    slowed_before: bool = False
    slowed_after: bool = False
    shares: tuple[float, ...] = ()

    def run(
        self,
        cost: TrajectoryCost,
        splines: Splines,
        ends: Ends,
        *,
        certified_margin: float = 0.0,
        spread: Spread = in_one,
    ) -> tuple[Splines, BoolArray]:
        """Return the optimised splines, and which of them are safe: [M].

        certified_margin: m, as in `are_safe`
        """
        limits, basis, dtype = cost.limits, cost.basis, splines.control.dtype
        control, duration = splines.control.copy(), splines.duration.astype(np.float64)
        safe = np.empty(len(splines), np.bool_)
        problem, style = cost.problem(dtype), cost.leaning(len(splines), dtype)
        descent = Descent.of(cost, ends, steps=self.steps, rate=self.rate, dtype=dtype)
        timing, points = self._timing(cost, ends), basis.points_of(ends)
        fields = cost.fields
        judge = Judge.of(
            basis, fields.clearance, limits, certified_margin, fields.movers, dtype=dtype
        )

        def work(begin: int, end: int) -> None:
            _run(
                problem, descent, timing, points, judge, control, duration, style, begin, end, safe
            )

        spread(work, len(splines))
        return Splines(control, duration), safe

    def _timing(self, cost: TrajectoryCost, ends: Ends) -> Timing:
        """Return the timing; stretching cannot reduce the speed or acceleration of an end."""
        limits, is_timed = cost.limits, cost.limits.horizon_s is None
        given = ends.derivatives[[1, 2, 4], :2]
        start_speed, start_acceleration, goal_speed = np.sqrt((given * given).sum(-1))
        return Timing(
            np.array(self.shares if is_timed else (), np.float64),
            is_timed and self.slowed_before,
            is_timed and self.slowed_after,
            float(max(limits.v_max, start_speed, goal_speed)),
            float(max(limits.a_max, start_acceleration)),
        )


class Timing(NamedTuple):
    """How durations may change: see `OptimisationPass`.

    speed, acceleration: m/s and m/s^2 above which slowing down helps
    """

    shares: NDArray[np.float64]
    slowed_before: bool
    slowed_after: bool
    speed: float
    acceleration: float


@compiled
def _run(
    problem: Problem,
    descent: Descent,
    timing: Timing,
    ends: EndPoints,
    judge: Judge,
    control: FloatArray,
    duration: NDArray[np.float64],
    style: FloatArray,
    begin: int,
    end: int,
    safe: BoolArray,
) -> None:
    """Change control points [D, M, K] and durations [M] from begin to end; write which are safe."""
    dim, _, points = control.shape
    taken, lasting = np.empty((dim, points, LANES), control.dtype), np.empty(LANES)
    leaning = np.empty((3, LANES), control.dtype)
    for first in range(begin, end, LANES):
        lanes = min(LANES, end - first)
        take_lanes(control, first, lanes, taken)
        for m in range(lanes):
            lasting[m] = duration[first + m]
            for k in range(3):
                leaning[k, m] = style[k, first + m]
        _run_on_lanes(problem, descent, timing, ends, taken, lasting, leaning, lanes)
        put_lanes(taken, first, lanes, control)
        for m in range(lanes):
            duration[first + m] = lasting[m]
    for m in range(begin, end):
        safe[m] = is_safe(control, duration, m, judge)


@compiled_part
def _run_on_lanes(
    problem: Problem,
    descent: Descent,
    timing: Timing,
    ends: EndPoints,
    control: FloatArray,
    duration: NDArray[np.float64],
    style: FloatArray,
    lanes: int,
) -> None:
    """Change control points [D, K, LANES] and durations [LANES]."""
    if timing.slowed_before:
        _slow_down(problem.band, timing, ends, control, duration, lanes)
    log_duration = np.empty(LANES)
    for m in range(lanes):
        log_duration[m] = np.log(duration[m])
    descend_lanes(problem, descent, ends, control, log_duration, style, lanes)
    if descent.is_timed:
        for m in range(lanes):
            duration[m] = np.exp(log_duration[m])
    if len(timing.shares):
        _speed_up(problem, timing, ends, control, duration, style, lanes)
    if timing.slowed_after:
        _slow_down(problem.band, timing, ends, control, duration, lanes)


@compiled_part
def _speed_up(
    problem: Problem,
    timing: Timing,
    ends: EndPoints,
    control: FloatArray,
    duration: NDArray[np.float64],
    style: FloatArray,
    lanes: int,
) -> None:
    """Give control points [D, K, LANES] the share of their duration that costs least.

    A descent smooths a path faster than it shortens its duration.
    """
    tried, slope, best = control.copy(), np.empty_like(control), control.copy()
    found, least = np.empty((2, LANES), control.dtype), np.empty(LANES, control.dtype)
    given, lasting = duration.copy(), np.empty(LANES)
    rounded = np.empty(LANES, control.dtype)
    for h in range(len(timing.shares)):
        for m in range(lanes):
            lasting[m] = given[m] * timing.shares[h]
            rounded[m] = lasting[m]
        set_lanes_ends(tried, lasting, ends, lanes)
        cost_of_lanes(problem, tried, rounded, style, lanes, found, slope, False)
        for m in range(lanes):
            if h == 0 or found[0, m] < least[m]:
                least[m], duration[m] = found[0, m], lasting[m]
                copy_lane(tried, m, best)
    for m in range(lanes):
        copy_lane(best, m, control)


@compiled_part
def _slow_down(
    band: Band,
    timing: Timing,
    ends: EndPoints,
    control: FloatArray,
    duration: NDArray[np.float64],
    lanes: int,
) -> None:
    """Stretch the control points [D, K, LANES] that exceed a limit until they keep it.

    The effect of an acceleration at an end grows with time: a trajectory whose excess would not
    shrink stays as it is.
    """
    needed, slower = np.empty(LANES, control.dtype), np.empty(LANES, control.dtype)
    _needed_stretch(band, timing, control, duration, lanes, needed)
    is_any, lasting = False, np.empty(LANES)
    for m in range(lanes):
        is_any |= needed[m] > 1.0
        lasting[m] = duration[m] * min(max(needed[m], 1.0), MOST_STRETCH)
    if not is_any:
        return
    tried = control.copy()
    set_lanes_ends(tried, lasting, ends, lanes)
    _needed_stretch(band, timing, tried, lasting, lanes, slower)
    for m in range(lanes):
        if slower[m] < needed[m]:
            duration[m] = lasting[m]
            copy_lane(tried, m, control)


@compiled_part
def _needed_stretch(
    band: Band,
    timing: Timing,
    control: FloatArray,
    duration: NDArray[np.float64],
    lanes: int,
    needed: FloatArray,
) -> None:
    """Write the factor on the duration that keeps both limits if the ends rest: [LANES]."""
    real = control.dtype.type
    samples = np.empty((3, control.shape[0], LANES), control.dtype)
    largest = np.zeros((2, LANES), control.dtype)
    for t in range(len(band.first)):
        sample_lanes(control, lanes, band, t, samples)
        for m in range(lanes):
            pace = real(1.0 / duration[m])
            x, y = samples[1, 0, m] * pace, samples[1, 1, m] * pace
            largest[0, m] = max(largest[0, m], x * x + y * y)
            x, y = samples[2, 0, m] * pace * pace, samples[2, 1, m] * pace * pace
            largest[1, m] = max(largest[1, m], x * x + y * y)
    for m in range(lanes):
        by_speed = np.sqrt(largest[0, m]) / real(timing.speed)
        hardest = np.sqrt(largest[1, m]) / real(timing.acceleration)
        needed[m] = max(by_speed, np.sqrt(hardest))
