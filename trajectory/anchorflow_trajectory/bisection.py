"""Bring trajectories that are still not safe back towards the nearest one that is.

Every mixture of two trajectories meets both ends, and keeps a speed and an acceleration that both
keep, so only obstacles stand between them: the mixture that goes furthest and is safe is found by
bisection. It costs no alternative, because only trajectories that had failed are moved.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.clearance import GridField
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.spline import SplineBasis
from anchorflow_trajectory.verify import verify

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

ROUNDS = 5
STRIDE = 4  # samples between the points by which trajectories are compared


def bisect_to_safe(
    control: FloatArray,
    safe: BoolArray,
    basis: SplineBasis,
    field: GridField,
    limits: MotionLimits,
    *,
    certified_margin: float = 0.0,
) -> FloatArray:
    """Control points [D, M, K], those that are not `safe` [M] moved; unmoved where none is.

    certified_margin: m, with which `safe` was judged
    """
    if safe.all() or not safe.any():
        return control
    positions = basis.states(control)[0]
    failed, sound = np.flatnonzero(~safe), np.flatnonzero(safe)
    nearest = control[:, sound[_nearest(positions[failed], positions[sound])]]
    away = control[:, failed] - nearest
    reached, beyond = np.zeros(len(failed), np.float32), np.ones(len(failed), np.float32)
    for _ in range(ROUNDS):
        tried = 0.5 * (reached + beyond)
        mixture = nearest + tried[:, None] * away
        states = basis.states(mixture)
        good = verify(states, field, limits, certified_margin=certified_margin).safe
        reached, beyond = np.where(good, tried, reached), np.where(good, beyond, tried)
    moved = control.copy()
    moved[:, failed] = nearest + reached[:, None] * away
    return moved


def _nearest(points: FloatArray, others: FloatArray) -> NDArray[np.intp]:
    """Index into `others` [Q, T, D] of the least mean squared distance from each of [P, T, D]."""
    a, b = (x[:, ::STRIDE].reshape(len(x), -1) for x in (points, others))
    return ((b**2).sum(-1) - 2 * a @ b.T).argmin(1)
