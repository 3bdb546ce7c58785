"""Which noise goes to which trajectory (mini-batch optimal transport; Tong et al., 2024).

Pairs are formed within a scene, so every trajectory keeps its condition; straighter paths need
fewer steps to follow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

FloatArray = NDArray[np.float32]


def couple(start: FloatArray, end: FloatArray, *, groups: NDArray[np.integer]) -> NDArray[np.int64]:
    """For each scene, the order of `end` that brings it nearest to `start`: [B, N].

    start, end: [B, N, Q], points to be compared by squared distance.
    groups: [B, N]; what stands in one stays in it.
    """
    order = np.tile(np.arange(start.shape[1]), (len(start), 1))
    for scene, labels in enumerate(groups):
        for label in np.unique(labels):
            own = np.flatnonzero(labels == label)
            distance = _distance(start[scene, own], end[scene, own])
            order[scene, own] = own[linear_sum_assignment(distance)[1]]
    return order


def _distance(a: FloatArray, b: FloatArray) -> FloatArray:
    return (a**2).sum(-1)[:, None] - 2 * a @ b.T + (b**2).sum(-1)
