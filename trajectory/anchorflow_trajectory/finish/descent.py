"""Preconditioned descent on the free control points and the durations.

Steps are taken in coordinates in which the smoothness term is round (as in CHOMP, Zucker et al.,
2013), so one step moves a whole stretch of the trajectory; Adam (Kingma & Ba, 2015) scales them.
A duration is one more coordinate (as in TEB, Rösmann et al., 2012, and MINCO, Wang et al., 2022).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.cost.kernels import Problem, cost_of_lanes
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.spline.basis import Ends, Splines, whitening
from anchorflow_trajectory.spline.kernels import (
    LANES,
    EndPoints,
    add_slopes_of_ends,
    put_lanes,
    set_lanes_ends,
    take_lanes,
)

BETAS = (0.8, 0.95)  # short memories: there are tens of steps, not thousands
LEAST_SIZE = 1e-6  # Adam's epsilon
STRETCH = 0.3  # change of log duration per metre of a control point


def descend(
    cost: TrajectoryCost,
    splines: Splines,
    ends: Ends,
    *,
    steps: int,
    rate: float,
    tether: float = 0.0,
) -> Splines:
    """Return the splines after `steps` steps of about `rate` metres, decaying to a tenth.

    Ends and headings stay: no obstacle or limit pulls at a heading, and Adam would scale its small
    slope up to `rate` radians. Durations stay if the limits have a horizon. Trajectories do not
    affect one another.

    tether: cost of 1 m^2 from the start, in the round coordinates. Set to temperature / variance of
        random starts, it yields samples of their distribution times exp(-J / temperature)
        (randomize-then-optimize; Bardsley et al., 2014).
    """
    dtype, kept = splines.control.dtype, cost.basis.points_of(ends)
    way = Descent.of(cost, ends, steps=steps, rate=rate, dtype=dtype, tether=tether)
    control, log_duration = splines.control.copy(), np.log(splines.duration)
    style = cost.leaning(len(splines), dtype)
    descend_splines(cost.problem(dtype), way, kept, control, log_duration, style)
    return Splines(control, np.exp(log_duration) if way.is_timed else splines.duration)


class Descent(NamedTuple):
    """The settings of a descent; steps, rate and tether as in `descend`.

    root: [F, F], the whitening; start: the first free control point
    is_timed: whether durations change; is_moving: whether ends then move control points
    """

    steps: int
    rate: float
    tether: float
    root: FloatArray
    start: int
    is_timed: bool
    is_moving: bool

    @staticmethod
    def of(
        cost: TrajectoryCost,
        ends: Ends,
        *,
        steps: int,
        rate: float,
        dtype: DTypeLike,
        tether: float = 0.0,
    ) -> Descent:
        """Return the settings for control points of a dtype."""
        basis = cost.basis
        return Descent(
            steps=steps,
            rate=float(rate),
            tether=float(tether),
            root=whitening(basis).astype(dtype),
            start=basis.free.start,
            is_timed=cost.limits.horizon_s is None,
            is_moving=not ends.at_rest,
        )


@compiled
def descend_splines(
    problem: Problem,
    way: Descent,
    ends: EndPoints,
    control: FloatArray,
    log_duration: NDArray[np.float64],
    style: FloatArray,
) -> None:
    """Change control points [D, M, K] and log durations [M] in place. style: [3, M]"""
    dim, count, points = control.shape
    taken = np.empty((dim, points, LANES), control.dtype)
    lasting, leaning = np.empty(LANES), np.empty((3, LANES), control.dtype)
    for begin in range(0, count, LANES):
        lanes = min(LANES, count - begin)
        take_lanes(control, begin, lanes, taken)
        for m in range(lanes):
            lasting[m] = log_duration[begin + m]
            for k in range(3):
                leaning[k, m] = style[k, begin + m]
        descend_lanes(problem, way, ends, taken, lasting, leaning, lanes)
        put_lanes(taken, begin, lanes, control)
        for m in range(lanes):
            log_duration[begin + m] = lasting[m]


@compiled_part
def descend_lanes(
    problem: Problem,
    way: Descent,
    ends: EndPoints,
    control: FloatArray,
    log_duration: NDArray[np.float64],
    style: FloatArray,
    lanes: int,
) -> None:
    """Change control points [D, K, LANES] and log durations [LANES] in place."""
    last, real = 2 * len(way.root), control.dtype.type
    duration, found = np.empty(LANES, control.dtype), np.empty((2, LANES), control.dtype)
    lasting = np.empty(LANES)
    slope = np.empty_like(control)
    # Rows are the round coordinates of x, then those of y, and last log duration.
    change = np.zeros((last + 1, LANES), control.dtype)
    away, mean, spread = np.zeros_like(change), np.zeros_like(change), np.zeros_like(change)
    for step in range(way.steps):
        for m in range(lanes):
            duration[m] = real(np.exp(log_duration[m]))
        cost_of_lanes(problem, control, duration, style, lanes, found, slope, True)
        _turn_slopes(way, slope, away, lanes, change)
        if way.is_timed:
            if way.is_moving:
                add_slopes_of_ends(slope, log_duration, ends, lanes, found[1])
            for m in range(lanes):
                change[last, m] = real(STRETCH) * found[1, m]
        decay = way.rate * 0.1 ** ((step + 1) / way.steps)
        _adam(change, mean, spread, step + 1, decay, lanes)
        _move(way, change, away, lanes, control)
        if way.is_timed:
            for m in range(lanes):
                log_duration[m] -= real(STRETCH) * change[last, m]
            if way.is_moving:
                for m in range(lanes):
                    lasting[m] = np.exp(log_duration[m])
                set_lanes_ends(control, lasting, ends, lanes)


@compiled_part
def _turn_slopes(
    way: Descent, slope: FloatArray, away: FloatArray, lanes: int, change: FloatArray
) -> None:
    """Write the slopes by the round coordinates, with the tether, into the rows of change."""
    free, tether = len(way.root), slope.dtype.type(way.tether)
    for row in range(2 * free):
        d, f = row // free, row % free
        for m in range(lanes):
            change[row, m] = tether * away[row, m]
        for q in range(free):
            share, point = way.root[q, f], way.start + q
            for m in range(lanes):
                change[row, m] += share * slope[d, point, m]


@compiled_part
def _move(
    way: Descent, change: FloatArray, away: FloatArray, lanes: int, control: FloatArray
) -> None:
    """Subtract the change of the round coordinates from control points [D, K, LANES]."""
    free = len(way.root)
    for row in range(2 * free):
        d, f = row // free, row % free
        for m in range(lanes):
            away[row, m] -= change[row, m]
        for q in range(free):
            share, point = way.root[q, f], way.start + q
            for m in range(lanes):
                control[d, point, m] -= share * change[row, m]


@compiled_part
def _adam(
    change: FloatArray, mean: FloatArray, spread: FloatArray, count: int, rate: float, lanes: int
) -> None:
    """Turn slopes [R, LANES] into Adam's decrements for step `count`."""
    real = change.dtype.type
    fresh, also_fresh = real(1.0 - BETAS[0]), real(1.0 - BETAS[1])
    whole = real(1.0 - BETAS[1] ** count)
    pace = real(rate / (1.0 - BETAS[0] ** count))
    for row in range(len(change)):
        for m in range(lanes):
            slope = change[row, m]
            mean[row, m] += fresh * (slope - mean[row, m])
            spread[row, m] += also_fresh * (slope * slope - spread[row, m])
            size = np.sqrt(spread[row, m] / whole) + real(LEAST_SIZE)
            change[row, m] = pace * mean[row, m] / size
