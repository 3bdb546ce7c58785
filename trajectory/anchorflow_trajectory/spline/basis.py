"""Clamped uniform B-splines with fixed ends (de Boor, *A Practical Guide to Splines*, 1978).

A trajectory is `p(s) = sum_k N_k(s) c_k` over its own time s = t / d in [0, 1], where d is its
duration. Its first three control points are set by the start's position, velocity and acceleration,
its last two by the goal's position and velocity; the rest are free. Position, velocity and
acceleration are linear in the control points, so they agree with one another exactly:

    v = p' / d,    a = p'' / d^2

Arrays are component first: control points are [D, M, K], samples [D, M, T] for M trajectories.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import DTypeLike, NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.caching import cached_property
from anchorflow_trajectory.spline.kernels import (
    Band,
    EndPoints,
    fit_free_points,
    sample_splines,
    set_end_points,
)

START_POINTS = 3  # control points that the start's p, v, a determine
GOAL_POINTS = 2  # control points that the goal's p, v determine
DEGREE = 4
END_ORDERS = np.array([0, 1, 2, 0, 1])  # of the derivatives that (p_0, v_0, a_0, p_T, v_T) are
STEEPNESS = 6.0  # typical ratio of a curve's successive derivatives by its own time
PLANE = slice(2)  # x and y
RIDGE = 1e-3  # keeps the whitening finite for slow, long bends


@dataclass(frozen=True, eq=False)
class Splines:
    """M trajectories: control points [D, M, K] in m, and how long each lasts, duration [M] in s."""

    control: FloatArray
    duration: FloatArray

    def __len__(self) -> int:
        return self.control.shape[1]

    def __getitem__(self, chosen: slice | NDArray[np.intp] | NDArray[np.bool_]) -> Splines:
        """Those that are chosen."""
        return Splines(self.control[:, chosen], self.duration[chosen])

    def replaced(self, chosen: NDArray[np.intp], others: Splines) -> Splines:
        """The same with others in the places that are chosen."""
        control, duration = self.control.copy(), self.duration.copy()
        control[:, chosen], duration[chosen] = others.control, others.duration
        return Splines(control, duration)


@dataclass(frozen=True, eq=False)
class Ends:
    """Where trajectories begin and end: x_curr [3D] p, v, a and x_goal [2D] p, v, all SI."""

    x_curr: FloatArray
    x_goal: FloatArray

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves at either end."""
        dim = len(self.x_goal) // 2
        return not (self.x_curr[dim:].any() or self.x_goal[dim:].any())

    @cached_property
    def derivatives(self) -> NDArray[np.float64]:
        """[5, D]: p, v, a at the start and p, v at the goal."""
        ends = (self.x_curr.reshape(3, -1), self.x_goal.reshape(2, -1))
        return np.concatenate(ends, dtype=np.float64)

    def in_own_time(self, duration: FloatArray) -> FloatArray:
        """Return [5, M, D]: p, p', p'' at s = 0 and p, p' at s = 1 for durations [M] s."""
        return self.derivatives[:, None] * (duration ** END_ORDERS[:, None])[..., None]


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """Basis matrices over a trajectory's own time; build it with `spline_basis`.

    position, velocity, acceleration, jerk: [T, K], of the derivatives by s of order 0 to 3
    ends: [K, 5], control points from (p, p', p'') at s = 0 and (p, p') at s = 1 with every free
        point zero
    degree: of its polynomials
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    ends: FloatArray
    degree: int

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
    def finer(self) -> SplineBasis | None:
        """Return the basis with twice the spans, or None if a span would have under two samples."""
        spans = 2 * (self.num_control_points - self.degree)
        if 2 * spans >= self.num_samples:
            return None
        return spline_basis(
            self.num_samples, num_control_points=spans + self.degree, degree=self.degree
        )

    def refined(self, splines: Splines) -> Splines:
        """The same curves on the finer basis, which holds all of this one's."""
        assert self.finer is not None
        return Splines(splines.control @ self._refinement, splines.duration)

    @cached_property
    def _refinement(self) -> FloatArray:
        """[K, K of the finer]"""
        assert self.finer is not None
        fine, coarse = (each.position.astype(np.float64) for each in (self.finer, self))
        return np.linalg.lstsq(fine, coarse, rcond=None)[0].T.astype(np.float32)

    @cached_property
    def stacked(self) -> FloatArray:
        """[K, 4T]: the four orders in one product."""
        rows = (self.position, self.velocity, self.acceleration, self.jerk)
        return np.ascontiguousarray(np.concatenate(rows).T)

    def band(self, dtype: DTypeLike) -> Band:
        """Return the nonzero band of the four orders for compiled loops."""
        return _band(self, np.dtype(dtype))

    @cached_property
    def fit_matrix(self) -> FloatArray:
        """[F, 3T]: least-squares free control points from weighted (p, p', p'') residuals."""
        # All three then have about the same spread.
        weights = np.repeat(STEEPNESS ** -np.arange(3.0), self.num_samples)
        rows = np.concatenate([self.position, self.velocity, self.acceleration])[:, self.free]
        return (np.linalg.pinv(rows * weights[:, None]) * weights).astype(np.float32)

    def end_points(self, ends: Ends, duration: FloatArray) -> FloatArray:
        """Control points [D, M, K] that meet both ends in durations [M], free ones zero."""
        fixed = self.points_of(ends)
        shape = (fixed.derivatives.shape[1], len(duration), self.num_control_points)
        control = np.zeros(shape, np.float32)
        set_end_points(control, np.ascontiguousarray(duration, np.float64), fixed)
        return control

    def points_of(self, ends: Ends) -> EndPoints:
        """The same, as compiled loops read it."""
        points, matrix = self._fixed
        return EndPoints(points, matrix, ends.derivatives, END_ORDERS)

    @cached_property
    def _fixed(self) -> tuple[NDArray[np.int64], FloatArray]:
        """[5], the control points that the ends set, and [5, 5], their rows of `ends`."""
        count = self.num_control_points
        points = np.array([*range(START_POINTS), *range(count - GOAL_POINTS, count)])
        return points, self.ends[points]

    def end_slopes(self, ends: Ends, duration: FloatArray) -> FloatArray:
        """Their derivatives by log duration, [D, M, K]."""
        slopes = END_ORDERS[:, None, None] * ends.in_own_time(duration)
        return np.einsum("ke,emd->dmk", self.ends, slopes).astype(np.float32)

    @cached_property
    def even(self) -> FloatArray:
        """Return control points [K] in [0, 1] of uniform motion along a line."""
        s = np.linspace(0.0, 1.0, self.num_samples)
        return np.linalg.lstsq(self.position.astype(np.float64), s, rcond=None)[0]

    def rest_curves(self, ends: Ends, duration: FloatArray) -> Splines:
        """The smoothest curves between both ends (least integral of squared jerk)."""
        fixed = self.end_points(ends, duration)
        return Splines(fixed + fixed @ self._rest_matrix, duration)

    @cached_property
    def _rest_matrix(self) -> FloatArray:
        free, hessian = self.free, self.jerk.T.astype(np.float64) @ self.jerk
        fill = np.zeros_like(hessian)
        fill[:, free] = -np.linalg.solve(hessian[free, free], hessian[free]).T
        return fill.astype(np.float32)

    def fit(self, states: FloatArray, ends: Ends, duration: FloatArray) -> Splines:
        """Nearest splines that meet both ends to p, p', p'' in own time [M, T, 3D]."""
        control = self.end_points(ends, duration)
        self._add_fit(states, control)
        return Splines(control, duration)

    def fit_free(self, states: FloatArray) -> FloatArray:
        """Free control points [D, M, F] nearest to p, p', p'' [M, T, 3D] with fixed ones zero."""
        count, _, size = states.shape
        control = np.zeros((size // 3, count, self.num_control_points), states.dtype)
        self._add_fit(states, control)
        return control[..., self.free]

    def _add_fit(self, states: FloatArray, control: FloatArray) -> None:
        """Make the free points of [D, M, K], which are zero, those nearest to p, p', p''."""
        dtype = control.dtype
        states = np.ascontiguousarray(states, dtype)
        matrix = self.fit_matrix.astype(dtype, copy=False)
        fit_free_points(states, control, matrix, self.band(dtype), self.free.start)

    def fit_positions(self, positions: FloatArray, ends: Ends, duration: FloatArray) -> Splines:
        """Nearest splines that meet both ends to positions [M, T, D] alone."""
        fixed = self.end_points(ends, duration)
        residual = positions.transpose(2, 0, 1) - fixed @ self.position.T
        fixed[..., self.free] = residual @ self._position_fit.T
        return Splines(fixed, duration)

    @cached_property
    def _position_fit(self) -> FloatArray:
        return np.linalg.pinv(self.position[:, self.free]).astype(np.float32)

    def own_time_states(self, control: FloatArray) -> FloatArray:
        """p, p', p'' [M, T, 3D] of control points [D, M, K]."""
        return np.concatenate(self._sampled(control, np.ones(control.shape[1])), axis=-1)

    def states(self, splines: Splines) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations [M, T, D] in SI."""
        position, velocity, acceleration = self._sampled(splines.control, 1.0 / splines.duration)
        return position, velocity, acceleration

    def _sampled(self, control: FloatArray, pace: FloatArray) -> FloatArray:
        control = np.ascontiguousarray(control)
        return sample_splines(control, pace.astype(control.dtype), self.band(control.dtype))


@lru_cache(maxsize=32)
def spline_basis(
    num_samples: int, *, num_control_points: int = 18, degree: int = DEGREE
) -> SplineBasis:
    """Basis of a clamped uniform B-spline sampled at `num_samples` equal steps of its own time."""
    inner = np.linspace(0.0, 1.0, num_control_points - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
    times = np.linspace(0.0, 1.0, num_samples)
    orders = [basis_functions(knots, degree, times, derivative=k) for k in range(4)]
    position, velocity, acceleration, jerk = (order.astype(np.float32) for order in orders)
    return SplineBasis(position, velocity, acceleration, jerk, _ends(orders), degree)


@lru_cache(maxsize=32)
def whitening(basis: SplineBasis) -> FloatArray:
    """[F, F]: free control points from coordinates in which mean squared acceleration is round.

    Standard normal coordinates make a smooth disturbance, of at most 1 m standard deviation.
    """
    free = basis.acceleration[:, basis.free].astype(np.float64)
    hessian = free.T @ free / len(free)
    hessian += RIDGE * np.trace(hessian) / len(hessian) * np.eye(len(hessian))
    root = np.linalg.inv(np.linalg.cholesky(hessian)).T
    return (root / np.abs(root @ root.T).diagonal().max() ** 0.5).astype(np.float32)


def basis_functions(
    knots: NDArray[np.float64], degree: int, times: NDArray[np.float64], *, derivative: int = 0
) -> NDArray[np.float64]:
    """Values [T, K], or derivatives, by the recursions of Cox and de Boor."""
    if degree == 0:
        # The last time belongs to the last piece that is not empty.
        spans = np.minimum(np.searchsorted(knots, times, "right"), _last_piece(knots)) - 1
        inside = spans[:, None] == np.arange(len(knots) - 1)
        return inside.astype(np.float64) * (derivative == 0)
    lower = basis_functions(knots, degree - 1, times, derivative=max(derivative - 1, 0))
    width = knots[degree:] - knots[:-degree]
    share = lower * np.divide(1.0, width, out=np.zeros_like(width), where=width > 0.0)
    if derivative:
        return degree * (share[:, :-1] - share[:, 1:])
    rising = times[:, None] - knots[: -degree - 1]
    falling = knots[degree + 1 :] - times[:, None]
    return rising * share[:, :-1] + falling * share[:, 1:]


def _last_piece(knots: NDArray[np.float64]) -> int:
    return int(np.searchsorted(knots, knots[-1]))


@lru_cache(maxsize=32)
def _band(basis: SplineBasis, dtype: np.dtype[np.floating]) -> Band:
    rows = np.stack([basis.position, basis.velocity, basis.acceleration, basis.jerk], axis=1)
    # Both the leaving and the joining function are zero at a knot, also in rows that jump there.
    is_used = rows.any(1)
    width = int(is_used.sum(1).max())
    first = np.minimum(is_used.argmax(1), basis.num_control_points - width)
    columns = first[:, None] + np.arange(width)
    weights = np.take_along_axis(rows, columns[:, None], axis=2)
    return Band(np.ascontiguousarray(weights, dtype), first)


def _ends(orders: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """[K, 5]: the fixed control points as functions of the end states."""
    position, velocity, acceleration, _ = orders
    count = position.shape[1]
    rows = np.stack([position[0], velocity[0], acceleration[0], position[-1], velocity[-1]])
    fixed = [*range(START_POINTS), *range(count - GOAL_POINTS, count)]
    ends = np.zeros((count, len(fixed)))
    ends[fixed] = np.linalg.inv(rows[:, fixed])
    return ends
