"""Compiled loops over splines: samples of them, the control points that ends set, and fits.

The innermost loop runs over trajectories, so that the compiler vectorises it; each trajectory's own
sums keep their order, whatever the batch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part

USUAL = 5  # control points that a sample depends on in splines of degree 4: summed in one loop
LANES = 64  # trajectories at a time, so that what is worked on stays in the nearest cache


class Band(NamedTuple):
    """The nonzero band of the basis matrices: each sample depends on a few control points.

    weights: [T, 4, degree + 1], of the derivatives by own time of order 0 to 3
    first: [T], the first of these control points
    """

    weights: FloatArray
    first: NDArray[np.int64]


class EndPoints(NamedTuple):
    """The control points that ends set, of trajectories of every duration.

    points: [E], which they are; matrix: [E, E], from the ends' derivatives by own time
    derivatives: [E, D] in SI, p, v, a at the start and p, v at the goal; orders: [E], theirs
    """

    points: NDArray[np.int64]
    matrix: FloatArray
    derivatives: NDArray[np.float64]
    orders: NDArray[np.int64]


@compiled_part
def sample_lanes(control: FloatArray, lanes: int, band: Band, t: int, samples: FloatArray) -> None:
    """Write the derivatives by own time of order 0 to O - 1 at sample t, [O, D, LANES].

    control: [D, K, LANES] control points; lanes: how many are in use
    """
    first = band.first[t]
    for order in range(samples.shape[0]):
        weight = band.weights[t, order]
        for d in range(samples.shape[1]):
            points, given = control[d], samples[order, d]
            if len(weight) == USUAL:
                w_0, w_1, w_2, w_3, w_4 = weight[0], weight[1], weight[2], weight[3], weight[4]
                for m in range(lanes):
                    total = w_0 * points[first, m] + w_1 * points[first + 1, m]
                    total = total + w_2 * points[first + 2, m] + w_3 * points[first + 3, m]
                    given[m] = total + w_4 * points[first + 4, m]
                continue
            for m in range(lanes):
                given[m] = weight[0] * points[first, m]
            for j in range(1, len(weight)):
                for m in range(lanes):
                    given[m] += weight[j] * points[first + j, m]


@compiled_part
def sample_one(control: FloatArray, m: int, band: Band, t: int, order: int) -> tuple[float, float]:
    """x and y of the m-th of splines [D, M, K] at sample t, or of a derivative by own time."""
    first, weight = band.first[t], band.weights[t, order, 0]
    x, y = weight * control[0, m, first], weight * control[1, m, first]
    for j in range(1, band.weights.shape[2]):
        weight = band.weights[t, order, j]
        x += weight * control[0, m, first + j]
        y += weight * control[1, m, first + j]
    return x, y


@compiled_part
def gather_slopes(samples: FloatArray, lanes: int, band: Band, t: int, slope: FloatArray) -> None:
    """Add to slopes by control points [D, K, LANES] what slopes by sample t [4, D, LANES] make."""
    for j in range(band.weights.shape[2]):
        point = band.first[t] + j
        place, speed = band.weights[t, 0, j], band.weights[t, 1, j]
        bend, jerk = band.weights[t, 2, j], band.weights[t, 3, j]
        for d in range(samples.shape[1]):
            for m in range(lanes):
                straight = place * samples[0, d, m] + speed * samples[1, d, m]
                bent = bend * samples[2, d, m] + jerk * samples[3, d, m]
                slope[d, point, m] += straight + bent


@compiled_part
def take_lanes(control: FloatArray, begin: int, lanes: int, taken: FloatArray) -> None:
    """Write control points [D, M, K] from place `begin` on as [D, K, LANES]."""
    for d in range(control.shape[0]):
        for m in range(lanes):
            for k in range(control.shape[2]):
                taken[d, k, m] = control[d, begin + m, k]


@compiled_part
def put_lanes(taken: FloatArray, begin: int, lanes: int, control: FloatArray) -> None:
    """The same back: write [D, K, LANES] to their places in [D, M, K]."""
    for d in range(control.shape[0]):
        for m in range(lanes):
            for k in range(control.shape[2]):
                control[d, begin + m, k] = taken[d, k, m]


@compiled_part
def copy_lane(control: FloatArray, m: int, target: FloatArray) -> None:
    """Copy lane m of [D, K, LANES]; a slice assigned to a slice would take longer to compile."""
    for d in range(control.shape[0]):
        for k in range(control.shape[1]):
            target[d, k, m] = control[d, k, m]


@compiled
def sample_splines(control: FloatArray, pace: FloatArray, band: Band) -> FloatArray:
    """Positions, velocities and accelerations [3, M, T, D] of control points [D, M, K].

    pace: [M], one over the duration, or 1 for derivatives by own time
    """
    dim, count, points = control.shape
    steps = len(band.first)
    states = np.empty((3, count, steps, dim), control.dtype)
    taken = np.empty((dim, points, LANES), control.dtype)
    samples = np.empty((3, dim, LANES), control.dtype)
    for begin in range(0, count, LANES):
        lanes = min(LANES, count - begin)
        take_lanes(control, begin, lanes, taken)
        for t in range(steps):
            sample_lanes(taken, lanes, band, t, samples)
            for d in range(dim):
                for m in range(lanes):
                    scale = pace[begin + m]
                    states[0, begin + m, t, d] = samples[0, d, m]
                    states[1, begin + m, t, d] = samples[1, d, m] * scale
                    states[2, begin + m, t, d] = samples[2, d, m] * scale * scale
    return states


@compiled_part
def end_point(ends: EndPoints, e: int, d: int, duration: float) -> float:
    """Component d of the e-th of the control points that ends set, in such a duration."""
    total = 0.0
    for given in range(len(ends.orders)):
        power = duration ** ends.orders[given]
        total += ends.matrix[e, given] * ends.derivatives[given, d] * power
    return total


@compiled
def set_end_points(control: FloatArray, duration: NDArray[np.float64], ends: EndPoints) -> None:
    """Write those of control points [D, M, K] that meet the ends in durations [M]."""
    for d in range(control.shape[0]):
        for m in range(len(duration)):
            for e in range(len(ends.points)):
                control[d, m, ends.points[e]] = end_point(ends, e, d, duration[m])


@compiled_part
def set_lanes_ends(
    control: FloatArray, duration: NDArray[np.float64], ends: EndPoints, lanes: int
) -> None:
    """The same of control points [D, K, LANES] and durations [LANES]."""
    for m in range(lanes):
        for d in range(control.shape[0]):
            for e in range(len(ends.points)):
                control[d, ends.points[e], m] = end_point(ends, e, d, duration[m])


@compiled_part
def add_slopes_of_ends(
    slope: FloatArray,
    log_duration: NDArray[np.float64],
    ends: EndPoints,
    lanes: int,
    by_duration: FloatArray,
) -> None:
    """Add the slope by log duration that control points [D, K, LANES] pass on through the ends."""
    size, dim = ends.derivatives.shape
    for m in range(lanes):
        duration, total = np.exp(log_duration[m]), 0.0
        for given in range(size):
            rate = ends.orders[given] * duration ** ends.orders[given]
            for e in range(size):
                for d in range(dim):
                    change = ends.matrix[e, given] * ends.derivatives[given, d] * rate
                    total += slope[d, ends.points[e], m] * change
        by_duration[m] += total


@compiled
def fit_free_points(
    states: FloatArray, control: FloatArray, matrix: FloatArray, band: Band, start: int
) -> None:
    """Add least-squares free points to control points [D, M, K] whose free ones are zero.

    states: [M, T, 3 D], p, p', p'' in own time; matrix: [F, 3 T], of the fit
    start: the first free point
    """
    dim, count, points = control.shape
    steps, free = len(band.first), len(matrix)
    taken = np.empty((dim, points, LANES), control.dtype)
    samples = np.empty((3, dim, LANES), control.dtype)
    fitted = np.empty((dim, free, LANES), control.dtype)
    for begin in range(0, count, LANES):
        lanes = min(LANES, count - begin)
        take_lanes(control, begin, lanes, taken)
        fitted[:] = 0.0
        for t in range(steps):
            sample_lanes(taken, lanes, band, t, samples)
            _subtract_from(states, begin, t, lanes, samples)
            for order in range(3):
                column = order * steps + t
                for d in range(dim):
                    for f in range(free):
                        share = matrix[f, column]
                        for m in range(lanes):
                            fitted[d, f, m] += share * samples[order, d, m]
        for d in range(dim):
            for m in range(lanes):
                for f in range(free):
                    control[d, begin + m, start + f] = fitted[d, f, m]


@compiled_part
def _subtract_from(states: FloatArray, begin: int, t: int, lanes: int, samples: FloatArray) -> None:
    """Samples [3, D, LANES] become what states [M, T, 3 D], from `begin` on, differ by."""
    dim = samples.shape[1]
    for order in range(3):
        for d in range(dim):
            for m in range(lanes):
                state = states[begin + m, t, order * dim + d]
                samples[order, d, m] = state - samples[order, d, m]
