"""Anchors of one scene, whoever proposed them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.spline import SplineBasis, Splines

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Proposals:
    """positions, velocities, accelerations: [N, T, D] in m, m/s, m/s^2.

    dt: s between samples, of all anchors or [N]
    safe: [N] what the planner promises, None where it promises nothing
    scores: [N] minus the cost of each, None where nobody has asked for it
    """

    positions: Array
    velocities: Array
    accelerations: Array
    dt: float | Array
    safe: NDArray[np.bool_] | None = None
    scores: Array | None = None

    @property
    def dts(self) -> Array:
        """[N] s between two samples of each anchor."""
        return np.broadcast_to(np.asarray(self.dt, np.float64), len(self.positions))

    @property
    def durations(self) -> Array:
        """[N] s from the first to the last sample."""
        return self.dts * (self.positions.shape[1] - 1)

    @staticmethod
    def of_spline(
        basis: SplineBasis, splines: Splines, *, safe: NDArray[np.bool_] | None = None
    ) -> Proposals:
        """The samples of N splines."""
        position, velocity, acceleration = (
            state.astype(np.float64) for state in basis.states(splines)
        )
        dt = splines.duration / (basis.num_samples - 1)
        return Proposals(position, velocity, acceleration, dt, safe)
