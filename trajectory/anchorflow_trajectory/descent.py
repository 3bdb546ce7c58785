"""Preconditioned descent on the free control points and the durations.

Steps are taken in coordinates in which the smoothness term is round (as in CHOMP, Zucker et al.,
2013), so one step moves a whole stretch of the trajectory; Adam (Kingma & Ba, 2015) scales them.
A duration is one more coordinate (as in TEB, Rösmann et al., 2012, and MINCO, Wang et al., 2022).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost import TrajectoryCost
from anchorflow_trajectory.spline import Ends, SplineBasis, Splines

FloatArray = NDArray[np.floating]

BETAS = (0.8, 0.95)  # short memories: there are tens of steps, not thousands
PLANE = slice(2)  # x and y
RIDGE = 1e-3  # keeps the whitening finite for slow, long bends
STRETCH = 0.3  # of log duration, where a control point moves 1 m


@lru_cache(maxsize=32)
def whitening(basis: SplineBasis, ridge: float = RIDGE) -> FloatArray:
    """[F, F]: free control points from coordinates in which mean squared acceleration is round.

    Standard normal coordinates make a smooth disturbance, of at most 1 m standard deviation.
    """
    free = basis.acceleration[:, basis.free].astype(np.float64)
    hessian = free.T @ free / len(free)
    hessian += ridge * np.trace(hessian) / len(hessian) * np.eye(len(hessian))
    root = np.linalg.inv(np.linalg.cholesky(hessian)).T
    return (root / np.abs(root @ root.T).diagonal().max() ** 0.5).astype(np.float32)


def descend(
    cost: TrajectoryCost,
    splines: Splines,
    ends: Ends,
    *,
    steps: int,
    rate: float,
    tether: float = 0.0,
) -> Splines:
    """Splines after `steps` steps of about `rate` metres, decaying to a tenth.

    The ends stay where they are, and so does a heading: no obstacle and no limit pulls at it, and
    Adam would scale what is left up to steps of `rate` radians. Durations stay where the limits
    have a horizon. Trajectories descend on their own.

    tether: cost of 1 m^2 away from where a trajectory began, in the round coordinates. Of random
        beginnings it makes samples of their distribution times exp(-J / temperature), where it is
        the temperature over their variance (randomize-then-optimize; Bardsley et al., 2014).
    """
    basis = cost.basis
    free, root = basis.free, whitening(basis)
    timed, moving = cost.limits.horizon_s is None, not ends.at_rest
    held = np.delete(np.arange(basis.num_control_points), free)
    control, log_duration = splines.control.copy(), np.log(splines.duration)
    moved = control[PLANE, :, free]
    count = len(splines)
    away = np.zeros_like(moved)
    adam = _Adam(moved.shape), _Adam((count,))
    for step in range(steps):
        duration = np.exp(log_duration)
        _, gradient = cost.value_and_gradient(Splines(control, duration))
        decay = rate * 0.1 ** ((step + 1) / steps)
        change = adam[0].step(gradient.control[PLANE, :, free] @ root + tether * away, decay)
        away -= change
        moved -= change @ root.T
        if timed:
            slope = gradient.log_duration
            if moving:
                ending = basis.end_slopes(ends, duration)
                slope = slope + np.einsum("dmk,dmk->m", gradient.control, ending)
            longer = adam[1].step(STRETCH * slope, decay)
            log_duration = log_duration - STRETCH * longer
            if moving:
                control[..., held] = basis.end_points(ends, np.exp(log_duration))[..., held]
    return Splines(control, np.exp(log_duration) if timed else splines.duration)


class _Adam:
    """Steps of one set of coordinates."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._mean = np.zeros(shape, np.float32)
        self._spread = np.zeros(shape, np.float32)
        self._count = 0

    def step(self, slope: FloatArray, rate: float) -> FloatArray:
        """What to take away."""
        self._count += 1
        self._mean += (1 - BETAS[0]) * (slope - self._mean)
        self._spread += (1 - BETAS[1]) * (slope**2 - self._spread)
        size = np.sqrt(self._spread / (1 - BETAS[1] ** self._count)) + 1e-6
        return rate / (1 - BETAS[0] ** self._count) * self._mean / size
