"""Known trajectories as states at a planner's own time steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

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
    spline = CubicSpline(np.linspace(0.0, horizon_s, steps), trajectories, axis=-2)
    times = np.linspace(0.0, horizon_s, num_steps)
    missing = FIELDS - columns // dim
    derived = [spline(times, order)[..., -dim:] for order in range(1, missing + 1)]
    return np.concatenate([spline(times), *derived], axis=-1).astype(np.float32)
