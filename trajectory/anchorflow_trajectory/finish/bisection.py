"""Bring trajectories that are still not safe back towards the nearest one that is.

Every mixture of two trajectories that rest at both ends meets these, and keeps a speed that both
keep, so hardly more than obstacles stands between them: the mixture that goes furthest and is safe
is found by bisection. It costs no alternative, because only trajectories that had failed are moved.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.finish.certificate import Judge, is_safe
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.spline.basis import Ends, SplineBasis, Splines
from anchorflow_trajectory.spline.kernels import EndPoints, end_point
from anchorflow_trajectory.threads import Spread, in_one

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

ROUNDS = 5
STRIDE = 4  # samples between the points by which trajectories are compared
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # whose multiples, modulo 1, lie well apart
LOST, FIRST, SECOND, NEAREST, TRIED = range(5)  # places of what is worked with
ELSEWHERE = 1e6  # m^2 by which a trajectory of another route is further away


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
    spread: Spread = in_one,
) -> Splines:
    """The splines, those that are not `safe` [M] moved; unmoved where none is.

    A failed one is brought to its nearest neighbours on its own route, and to one elsewhere only
    where its route has none. Where two are near, each failed one gets a place of its own between
    them if that is safe, so that many need not end in one.

    route: [M] the place of the route that each follows
    certified_margin: m, with which `safe` was judged
    spread: gives parts of the failed ones to threads
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
    judge = Judge.of(basis, field, limits, certified_margin, dtype=control.dtype)
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
    """Write the failed ones from begin to end of splines [D, M, K], moved: [D, P, K] and [P] s.

    places: [P, 3], of each failed one and of its nearest two neighbours
    share: [P], of the way from the first of these to the second that is its own
    """
    dim, _, points = control.shape
    work, lasts = np.empty((dim, 5, points), control.dtype), np.empty(5)
    for p in range(begin, end):
        for place, m in ((LOST, places[p, 0]), (FIRST, places[p, 1]), (SECOND, places[p, 2])):
            work[:, place], lasts[place] = control[:, m], duration[m]
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
        moved[:, p], lasting[p] = work[:, TRIED], lasts[TRIED]


@compiled
def _mix(
    control: FloatArray,
    duration: NDArray[np.float64],
    near: int,
    far: int,
    share: float,
    ends: EndPoints,
    place: int,
) -> None:
    """Write what lies a share of the way from one of splines [D, M, K] to another, at a place.

    Both ends are met.
    """
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
    """Indices [P, 2] into `others` [Q, T, D] of the least mean squared distances from [P, T, D].

    The same twice where there is one. away: [P, Q], those to take only where there is no other
    """
    a, b = (x[:, ::STRIDE].reshape(len(x), -1) for x in (points, others))
    order = ((b**2).sum(-1) - 2 * a @ b.T + ELSEWHERE * away).argsort(1)
    return order[:, [0, min(1, len(others) - 1)]]
