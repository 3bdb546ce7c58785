"""Bisect trajectories that are not safe towards the nearest safe ones.

Every mixture of two trajectories between the same resting ends meets both ends and keeps a speed
that both keep, so little but obstacles makes it unsafe. Bisection finds the mixture that is safe
and closest to the failed trajectory. Safe trajectories never move.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.finish.certificate import Judge, is_safe
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.movers import MovingDiscs
from anchorflow_trajectory.spline.basis import Ends, SplineBasis, Splines
from anchorflow_trajectory.spline.kernels import EndPoints, end_point
from anchorflow_trajectory.threads import Spread, in_one

ROUNDS = 5
STRIDE = 4  # samples between the points at which trajectories are compared
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # its multiples modulo 1 are well spaced
LOST, FIRST, SECOND, NEAREST, TRIED = range(5)  # rows of the working arrays
ELSEWHERE = 1e6  # m^2, penalty on trajectories of another route


def bisect_to_safe(
    splines: Splines,
    safe: BoolArray,
    ends: Ends,
    basis: SplineBasis,
    field: GridField,
    limits: MotionLimits,
    *,
    route: NDArray[np.intp],
    certified_margin: float = 0.0,
    movers: MovingDiscs | None = None,
    spread: Spread = in_one,
) -> Splines:
    """Return the splines with those that are not `safe` [M] moved, if any is safe.

    A failed spline moves towards its two nearest neighbours on its own route, or elsewhere if its
    route has none. Each gets its own point between the two if that is safe, so that failed
    splines do not all end in the same place.

    route: [M] index of the route that each follows
    certified_margin, movers: as for `safe`
    spread: runs ranges of the failed splines on threads
    """
    if safe.all() or not safe.any():
        return splines
    positions = basis.states(splines)[0]
    failed, sound = np.flatnonzero(~safe), np.flatnonzero(safe)
    away = route[failed, None] != route[sound]
    first, second = sound[_two_nearest(positions[failed], positions[sound], away)].T
    apart = np.arange(1, len(failed) + 1) * GOLDEN % 1.0
    control = np.ascontiguousarray(splines.control)
    given = np.ascontiguousarray(splines.duration, np.float64)
    places = np.stack([failed, first, second], axis=1)
    share = np.where(route[first] == route[second], apart, 0.0)
    points = basis.points_of(ends)
    judge = Judge.of(basis, field, limits, certified_margin, movers, dtype=control.dtype)
    moved = np.empty((len(control), len(failed), control.shape[2]), control.dtype)
    duration = np.empty(len(failed))

    def work(begin: int, end: int) -> None:
        _bisect(control, given, places, share, points, judge, begin, end, moved, duration)

    spread(work, len(failed))
    return splines.replaced(failed, Splines(moved, duration))


@compiled
def _bisect(
    control: FloatArray,
    duration: NDArray[np.float64],
    places: NDArray[np.int64],
    share: NDArray[np.float64],
    ends: EndPoints,
    judge: Judge,
    begin: int,
    end: int,
    moved: FloatArray,
    lasting: NDArray[np.float64],
) -> None:
    """Write failed splines begin to end of [D, M, K], moved: [D, P, K] and [P] s.

    places: [P, 3], indices of a failed spline and of its two nearest neighbours
    share: [P], position of its target between the first neighbour and the second
    """
    dim, _, points = control.shape
    work, lasts = np.empty((dim, 5, points), control.dtype), np.empty(5)
    for p in range(begin, end):
        for place, m in ((LOST, places[p, 0]), (FIRST, places[p, 1]), (SECOND, places[p, 2])):
            lasts[place] = duration[m]
            _copy(control, m, work, place)
        _mix(work, lasts, FIRST, SECOND, share[p], ends, NEAREST)
        if not is_safe(work, lasts, NEAREST, judge):
            _mix(work, lasts, FIRST, SECOND, 0.0, ends, NEAREST)
        reached, beyond = 0.0, 1.0
        for _ in range(ROUNDS):
            middle = 0.5 * (reached + beyond)
            _mix(work, lasts, NEAREST, LOST, middle, ends, TRIED)
            if is_safe(work, lasts, TRIED, judge):
                reached = middle
            else:
                beyond = middle
        _mix(work, lasts, NEAREST, LOST, reached, ends, TRIED)
        lasting[p] = lasts[TRIED]
        _copy(work, TRIED, moved, p)


@compiled_part
def _copy(control: FloatArray, m: int, target: FloatArray, place: int) -> None:
    for d in range(control.shape[0]):
        for k in range(control.shape[2]):
            target[d, place, k] = control[d, m, k]


@compiled_part
def _mix(
    control: FloatArray,
    duration: NDArray[np.float64],
    near: int,
    far: int,
    share: float,
    ends: EndPoints,
    place: int,
) -> None:
    """Write a mixture of two of splines [D, M, K] at `place`; it meets both ends."""
    weight = control.dtype.type(share)
    for d in range(control.shape[0]):
        for k in range(control.shape[2]):
            begin = control[d, near, k]
            control[d, place, k] = begin + weight * (control[d, far, k] - begin)
    duration[place] = duration[near] + share * (duration[far] - duration[near])
    for d in range(control.shape[0]):
        for e in range(len(ends.points)):
            control[d, place, ends.points[e]] = end_point(ends, e, d, duration[place])


def _two_nearest(points: FloatArray, others: FloatArray, away: BoolArray) -> NDArray[np.intp]:
    """Return indices [P, 2] of the `others` [Q, T, D] nearest to points [P, T, D], in mean square.

    A single other counts twice. away: [P, Q], others on another route
    """
    a, b = (x[:, ::STRIDE].reshape(len(x), -1) for x in (points, others))
    order = ((b**2).sum(-1) - 2 * a @ b.T + ELSEWHERE * away).argsort(1)
    return order[:, [0, min(1, len(others) - 1)]]
