"""Preconditioned descent on the free control points.

Steps are taken in coordinates in which the smoothness term is round (as in CHOMP, Zucker et al.,
2013), so one step moves a whole stretch of the trajectory; Adam (Kingma & Ba, 2015) scales them.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost import TrajectoryCost
from anchorflow_trajectory.spline import SplineBasis

FloatArray = NDArray[np.floating]

BETAS = (0.8, 0.95)  # short memories: there are tens of steps, not thousands
PLANE = slice(2)  # x and y
RIDGE = 1e-3  # keeps the whitening finite for slow, long bends


@lru_cache(maxsize=32)
def whitening(basis: SplineBasis, ridge: float = RIDGE) -> FloatArray:
    """[F, F]: free control points from coordinates in which mean squared acceleration is round.

    Standard normal coordinates make a smooth disturbance, of at most 1 m standard deviation.
    """
    free = basis.acceleration[:, basis.free].astype(np.float64) * basis.horizon_s**2
    hessian = free.T @ free / len(free)
    hessian += ridge * np.trace(hessian) / len(hessian) * np.eye(len(hessian))
    root = np.linalg.inv(np.linalg.cholesky(hessian)).T
    return (root / np.abs(root @ root.T).diagonal().max() ** 0.5).astype(np.float32)


def descend(cost: TrajectoryCost, control: FloatArray, *, steps: int, rate: float) -> FloatArray:
    """Control points [D, M, K] after `steps` steps of about `rate` metres, decaying to a tenth.

    The ends stay where they are, and so does a heading: no obstacle and no limit pulls at it, and
    Adam would scale what is left up to steps of `rate` radians. Trajectories descend on their own.
    """
    free, root = cost.basis.free, whitening(cost.basis)
    control = control.copy()
    moved = control[PLANE, :, free]
    mean = np.zeros_like(moved)
    spread = np.zeros_like(mean)
    for step in range(1, steps + 1):
        _, gradient = cost.value_and_gradient(control)
        slope = gradient[PLANE, :, free] @ root
        mean += (1 - BETAS[0]) * (slope - mean)
        spread += (1 - BETAS[1]) * (slope**2 - spread)
        size = np.sqrt(spread / (1 - BETAS[1] ** step)) + 1e-6
        decay = rate * 0.1 ** (step / steps) / (1 - BETAS[0] ** step)
        moved -= (decay * mean / size) @ root.T
    return control
