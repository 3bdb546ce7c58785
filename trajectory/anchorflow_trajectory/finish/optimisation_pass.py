"""An attempt of the finish in one compiled call: slow down, descend, hurry, and judge.

The call holds no lock of the interpreter from its beginning to its end, and parts of the anchors
may be given to threads: each is worked on alone, so that its bytes are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.cost.kernels import Problem, cost_of_lanes
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.finish.certificate import Judge, is_safe
from anchorflow_trajectory.finish.descent import Descent, descend_lanes
from anchorflow_trajectory.spline.basis import Ends, Splines
from anchorflow_trajectory.spline.kernels import (
    LANES,
    Band,
    EndPoints,
    put_lanes,
    sample_lanes,
    set_lanes_ends,
    take_lanes,
)
from anchorflow_trajectory.threads import Spread, in_one

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

MOST_STRETCH = 3.0


@dataclass(frozen=True)
class Attempt:
    """What is done to anchors before they are judged; durations stay where limits have a horizon.

    steps, rate: of the descents, as `descend` has them
    slowed_before, slowed_after: whether, before or after the descents, what exceeds a limit is gone
        as slowly as the limits ask, as far as the ends allow
    shares: of a duration after the descents, of which the one that costs least is kept
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
        """The splines after it, and which of them are safe: [M].

        certified_margin: m that `are_safe` asks for
        """
        limits, basis, dtype = cost.limits, cost.basis, splines.control.dtype
        control, duration = splines.control.copy(), splines.duration.astype(np.float64)
        safe = np.empty(len(splines), np.bool_)
        problem, style = cost.problem(dtype), cost.leaning(len(splines), dtype)
        way = Descent.of(cost, ends, steps=self.steps, rate=self.rate, dtype=dtype)
        timing, points = self._timing(cost, ends), basis.points_of(ends)
        judge = Judge.of(basis, cost.fields.clearance, limits, certified_margin, dtype=dtype)

        def work(begin: int, end: int) -> None:
            _attempt(
                problem, way, timing, points, judge, control, duration, style, begin, end, safe
            )

        spread(work, len(splines))
        return Splines(control, duration), safe

    def _timing(self, cost: TrajectoryCost, ends: Ends) -> Timing:
        """What an end brings along does not become less with time: no stretch is asked for it."""
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
    """How durations may change; `Attempt` tells of shares and of both slowed_….

    speed, acceleration: m/s and m/s^2 above which slowing down helps
    """

    shares: NDArray[np.float64]
    slowed_before: bool
    slowed_after: bool
    speed: float
    acceleration: float


@compiled
def _attempt(
    problem: Problem,
    way: Descent,
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
        _attempt_lanes(problem, way, timing, ends, taken, lasting, leaning, lanes)
        put_lanes(taken, first, lanes, control)
        for m in range(lanes):
            duration[first + m] = lasting[m]
    for m in range(begin, end):
        safe[m] = is_safe(control, duration, m, judge)


@compiled
def _attempt_lanes(
    problem: Problem,
    way: Descent,
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
    descend_lanes(problem, way, ends, control, log_duration, style, lanes)
    if way.is_timed:
        for m in range(lanes):
            duration[m] = np.exp(log_duration[m])
    if len(timing.shares):
        _hurry(problem, timing, ends, control, duration, style, lanes)
    if timing.slowed_after:
        _slow_down(problem.band, timing, ends, control, duration, lanes)


@compiled
def _hurry(
    problem: Problem,
    timing: Timing,
    ends: EndPoints,
    control: FloatArray,
    duration: NDArray[np.float64],
    style: FloatArray,
    lanes: int,
) -> None:
    """Each of control points [D, K, LANES] in the share of its duration that costs it least.

    Descents smooth a way faster than they find out how soon it can then be driven.
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
                best[:, :, m] = tried[:, :, m]
    control[:] = best


@compiled
def _slow_down(
    band: Band,
    timing: Timing,
    ends: EndPoints,
    control: FloatArray,
    duration: NDArray[np.float64],
    lanes: int,
) -> None:
    """Stretch what exceeds a limit until it keeps it, of control points [D, K, LANES].

    What an acceleration at an end does to the speed grows with time: where the excess would not
    become less, a way stays as it is.
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
            control[:, :, m] = tried[:, :, m]


@compiled
def _needed_stretch(
    band: Band,
    timing: Timing,
    control: FloatArray,
    duration: NDArray[np.float64],
    lanes: int,
    needed: FloatArray,
) -> None:
    """Write how many times the duration keeps both limits, were the ends at rest: [LANES]."""
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
