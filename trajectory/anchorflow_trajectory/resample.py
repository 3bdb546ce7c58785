"""Known trajectories as states at a planner's own time steps."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]

FIELDS = 3  # position, velocity, acceleration


def whole_fields(columns: int, dim: int) -> bool:
    """Whether that many columns are whole positions, velocities and accelerations of D = `dim`."""
    return columns % dim == 0 and 1 <= columns // dim <= FIELDS


def resampled_states(
    trajectories: FloatArray, *, dim: int, num_steps: int, horizon_s: float
) -> FloatArray:
    """[..., T', D], [..., T', 2D] or [..., T', 3D] over the horizon as states [..., T, 3D].

    What is given is interpolated by cubic splines, and derivatives that are missing are theirs.
    """
    steps, columns = trajectories.shape[-2:]
    weights, step_s = cubic_weights(steps, num_steps), horizon_s / (steps - 1)
    missing = FIELDS - columns // dim
    derived = [
        (weights[order] / step_s**order) @ trajectories[..., -dim:]
        for order in range(1, missing + 1)
    ]
    return np.concatenate([weights[0] @ trajectories, *derived], axis=-1).astype(np.float32)


@lru_cache(maxsize=32)
def cubic_weights(steps: int, num_steps: int) -> NDArray[np.float64]:
    """[3, T, T']: value, slope and bend of the cubic spline through T' samples a unit apart, at T
    equal steps, as sums of the samples.

    The spline is one cubic over the first two pieces and one over the last two ("not a knot"; de
    Boor, *A Practical Guide to Splines*, 1978, chapter IV): the parabola through three samples, the
    line through two.
    """
    samples = np.eye(steps)
    bends = np.diff(samples, n=2, axis=0)
    known, ties = np.zeros((steps, steps)), np.zeros((steps, steps))
    known[1:-1], ties[1:-1] = 6.0 * bends, bends + 6.0 * samples[1:-1]
    ties[[0, -1]] = np.diff(samples, n=min(2, steps - 2), axis=0)[[0, -1]]
    second = np.linalg.solve(ties, known)  # at the samples

    at = np.linspace(0.0, steps - 1.0, num_steps)
    piece = np.minimum(at.astype(int), steps - 2)
    right = (at - piece)[:, None]
    left = 1.0 - right
    value = left * samples[piece] + right * samples[piece + 1]
    value += ((left**3 - left) * second[piece] + (right**3 - right) * second[piece + 1]) / 6.0
    slope = samples[piece + 1] - samples[piece]
    slope += ((3 * right**2 - 1) * second[piece + 1] - (3 * left**2 - 1) * second[piece]) / 6.0
    weights = np.stack([value, slope, left * second[piece] + right * second[piece + 1]])
    weights.setflags(write=False)
    return weights
