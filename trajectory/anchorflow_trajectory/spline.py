"""Clamped uniform B-splines with fixed ends (de Boor, *A Practical Guide to Splines*, 1978).

A trajectory is `p(t) = sum_k N_k(t) c_k` over the horizon. Its first three control points are set
by the start's position, velocity and acceleration, its last two by the goal's position and
velocity; the rest are free. Position, velocity and acceleration samples are linear in the control
points, so they agree with one another exactly.

Arrays are component first: control points are [D, M, K], samples [D, M, T] for M trajectories.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

FloatArray = NDArray[np.floating]

START_POINTS = 3  # control points that the start's p, v, a determine
GOAL_POINTS = 2  # control points that the goal's p, v determine


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """Basis matrices of one horizon; build it with `spline_basis`.

    position, velocity, acceleration, jerk: [T, K] in 1, 1/s, 1/s^2, 1/s^3
    ends: [K, 5], control points from (p_0, v_0, a_0, p_T, v_T) with every free point zero
    """

    horizon_s: float
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    ends: FloatArray

    @property
    def num_samples(self) -> int:
        return self.position.shape[0]

    @property
    def num_control_points(self) -> int:
        return self.position.shape[1]

    @property
    def free(self) -> slice:
        """The control points that the ends leave free."""
        return slice(START_POINTS, self.num_control_points - GOAL_POINTS)

    @cached_property
    def stacked(self) -> FloatArray:
        """[K, 4T]: position, velocity, acceleration and jerk in one product."""
        rows = (self.position, self.velocity, self.acceleration, self.jerk)
        return np.ascontiguousarray(np.concatenate(rows).T)

    @cached_property
    def fit_matrix(self) -> FloatArray:
        """[F, 3T]: least-squares free control points from weighted (p, v, a) residuals."""
        weights = self._fit_weights
        rows = np.concatenate([self.position, self.velocity, self.acceleration])[:, self.free]
        return (np.linalg.pinv(rows * weights[:, None]) * weights).astype(np.float32)

    @cached_property
    def _fit_weights(self) -> FloatArray:
        # Derivatives in units of the horizon: all three then have about the same spread.
        scale = np.array([1.0, self.horizon_s / 6.0, (self.horizon_s / 6.0) ** 2], np.float32)
        return np.repeat(scale, self.num_samples)

    def end_points(self, x_curr: FloatArray, x_goal: FloatArray) -> FloatArray:
        """Control points that meet both ends, free ones zero: [D, K] from [3D] and [2D]."""
        ends = np.concatenate([x_curr.reshape(3, -1), x_goal.reshape(2, -1)])
        return (self.ends @ ends).T.astype(np.float32)

    def rest_curve(self, x_curr: FloatArray, x_goal: FloatArray) -> FloatArray:
        """The smoothest curve between both ends (least integral of squared jerk): [D, K]."""
        fixed = self.end_points(x_curr, x_goal)
        return fixed + fixed @ self._rest_matrix

    @cached_property
    def _rest_matrix(self) -> FloatArray:
        free, hessian = self.free, self.jerk.T.astype(np.float64) @ self.jerk
        fill = np.zeros_like(hessian)
        fill[:, free] = -np.linalg.solve(hessian[free, free], hessian[free]).T
        return fill.astype(np.float32)

    def fit(self, state: FloatArray, x_curr: FloatArray, x_goal: FloatArray) -> FloatArray:
        """Nearest control points [D, M, K] to states [M, T, 3D] among those that meet both ends."""
        fixed = self.end_points(x_curr, x_goal)
        trajectories, samples, size = state.shape
        fields = state.reshape(trajectories, samples, 3, size // 3).transpose(3, 0, 2, 1)
        fields = fields.reshape(size // 3, trajectories, 3 * samples)
        control = np.repeat(fixed[:, None], trajectories, axis=1)
        residual = fields - (fixed @ self.stacked[:, : 3 * samples])[:, None]
        control[..., self.free] = residual @ self.fit_matrix.T
        return control

    def fit_positions(
        self, positions: FloatArray, x_curr: FloatArray, x_goal: FloatArray
    ) -> FloatArray:
        """Nearest control points [D, M, K] to positions [M, T, D] alone, both ends met."""
        fixed = self.end_points(x_curr, x_goal)
        residual = positions.transpose(2, 0, 1) - (fixed @ self.position.T)[:, None]
        control = np.repeat(fixed[:, None], len(positions), axis=1)
        control[..., self.free] = residual @ self._position_fit.T
        return control

    @cached_property
    def _position_fit(self) -> FloatArray:
        return np.linalg.pinv(self.position[:, self.free]).astype(np.float32)

    def states(self, control: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations [M, T, D] of control points [D, M, K]."""
        samples = (control @ self.stacked[:, : 3 * self.num_samples]).transpose(1, 2, 0)
        position, velocity, acceleration = np.split(samples, 3, axis=1)
        return position, velocity, acceleration


@lru_cache(maxsize=32)
def spline_basis(
    num_samples: int, horizon_s: float, *, num_control_points: int = 18, degree: int = 4
) -> SplineBasis:
    """Basis of a clamped uniform B-spline sampled at `num_samples` equal steps over the horizon."""
    inner = np.linspace(0.0, 1.0, num_control_points - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
    spline = BSpline(knots, np.eye(num_control_points), degree)
    times = np.linspace(0.0, 1.0, num_samples)
    orders = [spline.derivative(k)(times) / horizon_s**k for k in range(4)]
    position, velocity, acceleration, jerk = (order.astype(np.float32) for order in orders)
    return SplineBasis(horizon_s, position, velocity, acceleration, jerk, _ends(orders))


def _ends(orders: list[NDArray[np.float64]]) -> FloatArray:
    """[K, 5]: the fixed control points as functions of the end states."""
    position, velocity, acceleration, _ = orders
    count = position.shape[1]
    rows = np.stack([position[0], velocity[0], acceleration[0], position[-1], velocity[-1]])
    fixed = [*range(START_POINTS), *range(count - GOAL_POINTS, count)]
    ends = np.zeros((count, len(fixed)))
    ends[fixed] = np.linalg.inv(rows[:, fixed])
    return ends.astype(np.float32)
