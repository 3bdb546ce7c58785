"""Bring trajectories that are still not safe back towards the nearest one that is.

Every mixture of two trajectories that rest at both ends meets these, and keeps a speed that both
keep, so hardly more than obstacles stands between them: the mixture that goes furthest and is safe
is found by bisection. It costs no alternative, because only trajectories that had failed are moved.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.clearance import GridField
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.spline import Ends, SplineBasis, Splines
from anchorflow_trajectory.verify import verify

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

ROUNDS = 5
STRIDE = 4  # samples between the points by which trajectories are compared
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # whose multiples, modulo 1, lie well apart
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
) -> Splines:
    """The splines, those that are not `safe` [M] moved; unmoved where none is.

    A failed one is brought to its nearest neighbours on its own route, and to one elsewhere only
    where its route has none. Where two are near, each failed one gets a place of its own between
    them if that is safe, so that many need not end in one.

    route: [M] the place of the route that each follows
    certified_margin: m, with which `safe` was judged
    """
    if safe.all() or not safe.any():
        return splines
    positions = basis.states(splines)[0]
    failed, sound = np.flatnonzero(~safe), np.flatnonzero(safe)
    away = route[failed, None] != route[sound]
    first, second = sound[_two_nearest(positions[failed], positions[sound], away)].T

    def is_safe(mixture: Splines) -> BoolArray:
        states = basis.states(mixture)
        return verify(states, field, limits, certified_margin=certified_margin).safe

    lost, share = splines[failed], np.arange(1, len(failed) + 1) * GOLDEN % 1.0
    between = _mixed(splines[first], splines[second], share, ends, basis)
    same_route = route[first] == route[second]
    share = np.where(same_route & is_safe(between), share, 0.0)
    nearest = _mixed(splines[first], splines[second], share, ends, basis)
    reached, beyond = np.zeros(len(failed)), np.ones(len(failed))
    for _ in range(ROUNDS):
        tried = 0.5 * (reached + beyond)
        good = is_safe(_mixed(nearest, lost, tried, ends, basis))
        reached, beyond = np.where(good, tried, reached), np.where(good, beyond, tried)
    return splines.replaced(failed, _mixed(nearest, lost, reached, ends, basis))


def _mixed(
    near: Splines, far: Splines, share: FloatArray, ends: Ends, basis: SplineBasis
) -> Splines:
    """What lies a share [M] of the way from one to the other, with both ends met."""
    weight = share.astype(np.float32)[:, None]
    control = near.control + weight * (far.control - near.control)
    duration = near.duration + share * (far.duration - near.duration)
    free = basis.free
    fixed = basis.end_points(ends, duration)
    fixed[..., free] = control[..., free]
    return Splines(fixed, duration)


def _two_nearest(points: FloatArray, others: FloatArray, away: BoolArray) -> NDArray[np.intp]:
    """Indices [P, 2] into `others` [Q, T, D] of the least mean squared distances from [P, T, D].

    The same twice where there is one. away: [P, Q], those to take only where there is no other
    """
    a, b = (x[:, ::STRIDE].reshape(len(x), -1) for x in (points, others))
    order = ((b**2).sum(-1) - 2 * a @ b.T + ELSEWHERE * away).argsort(1)
    return order[:, [0, min(1, len(others) - 1)]]
