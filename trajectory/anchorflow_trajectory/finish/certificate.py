"""Is a trajectory safe? Clearance along the whole path, speed and acceleration at its samples.

The service's `safe`, the expert's `good` and the trainer's scores all use this verdict.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.cost.fields import Grid, look_up
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.movers import Discs, MovingDiscs, moving_clearance
from anchorflow_trajectory.spline.basis import Ends, SplineBasis, Splines
from anchorflow_trajectory.spline.kernels import Band, sample_one

CHECK_STEP = 0.04  # m between the points at which clearance is looked up
BULGE = 0.01  # m from the chord of two samples, up to which the chord stands for the motion
NEAR = 0.001  # m, against rounding where points are passed over
FAR_OUT = 4  # half perimeters of the map: a longer leg has its least clearance at an end
# A bilinear field and another reader's rounding to cells differ by less than this share of a cell.
SHARE_OF_CELL = 0.3
APART = 0.002  # m beyond a margin that is kept from what moves, against rounding
SPEED_TOLERANCE, ACCELERATION_TOLERANCE = 1.02, 1.05
END_TOLERANCE = 0.05  # m by which sampled states may miss an end


@dataclass(frozen=True)
class Verdict:
    """The result of `verify`, for each of M trajectories.

    clearance: m beyond the robot's radius, smallest along the path
    free: clear of every obstacle and of the map's edge by the certified margin
    feasible: within both limits
    """

    clearance: FloatArray
    free: BoolArray
    feasible: BoolArray

    @property
    def safe(self) -> BoolArray:
        """Free and feasible."""
        return self.free & self.feasible


def verify(
    states: tuple[FloatArray, FloatArray, FloatArray],
    field: GridField,
    limits: MotionLimits,
    *,
    certified_margin: float = 0.0,
    movers: MovingDiscs | None = None,
    duration: FloatArray | None = None,
) -> Verdict:
    """Check positions, velocities and accelerations [M, T, D].

    certified_margin: m beyond the robot's radius from every obstacle and from the map's edge; a
        share of a cell is added, so that it holds for other interpolations too
    movers: what moves, wider by the robot's radius; with it, duration: [M] s
    """
    position, velocity, acceleration = states
    position = np.ascontiguousarray(position)
    clearance = _motion_clearance(Grid.of(field, position.dtype), position)
    free = clearance >= required_clearance(field, certified_margin)
    if movers is not None:
        assert duration is not None
        discs, lasting = Discs.of(movers, np.float64), np.asarray(duration, np.float64)
        apart = _moving_clearances(discs, position, lasting)
        free &= apart >= certified_margin + APART
        clearance = np.minimum(clearance, apart)
    feasible = largest_length(velocity) <= SPEED_TOLERANCE * limits.v_max
    feasible &= largest_length(acceleration) <= ACCELERATION_TOLERANCE * limits.a_max
    return Verdict(clearance, free, feasible)


def is_one_motion(
    states: tuple[FloatArray, FloatArray, FloatArray],
    duration: FloatArray,
    ends: Ends,
    limits: MotionLimits,
) -> BoolArray:
    """Whether sampled states are one motion from start to goal within the limits: [M].

    They begin and end in the right place, and their finite differences keep the limits.

    states: positions, velocities and accelerations [M, T, D]; duration: [M] s
    """
    position, velocity, _ = (each[..., :2] for each in states)
    step = duration[:, None, None] / (position.shape[1] - 1)
    start, goal = ends.x_curr[:2], ends.x_goal[:2]
    missed = largest_length(np.stack([position[:, 0] - start, position[:, -1] - goal], axis=1))
    speed = largest_length(np.diff(position, axis=1) / step)
    pull = largest_length(np.diff(velocity, axis=1) / step)
    found = (missed <= END_TOLERANCE) & (speed <= SPEED_TOLERANCE * limits.v_max)
    return found & (pull <= ACCELERATION_TOLERANCE * limits.a_max)


def are_safe(
    splines: Splines,
    basis: SplineBasis,
    field: GridField,
    limits: MotionLimits,
    *,
    certified_margin: float = 0.0,
    movers: MovingDiscs | None = None,
) -> BoolArray:
    """Return `verify(...).safe` [M] for the states of M splines, in less time."""
    control = np.ascontiguousarray(splines.control)
    judge = Judge.of(basis, field, limits, certified_margin, movers, dtype=control.dtype)
    return _are_safe(control, np.ascontiguousarray(splines.duration, np.float64), judge)


class Judge(NamedTuple):
    """The bounds of a safe spline for compiled loops; both limits include their tolerance."""

    band: Band
    grid: Grid
    movers: Discs | None
    clearance: float
    apart: float
    speed: float
    acceleration: float

    @staticmethod
    def of(
        basis: SplineBasis,
        field: GridField,
        limits: MotionLimits,
        certified_margin: float,
        movers: MovingDiscs | None = None,
        *,
        dtype: DTypeLike,
    ) -> Judge:
        """For splines of that type."""
        return Judge(
            basis.band(dtype),
            Grid.of(field, dtype),
            movers and Discs.of(movers, np.float64),
            float(required_clearance(field, certified_margin)),
            float(certified_margin + APART),
            float(SPEED_TOLERANCE * limits.v_max),
            float(ACCELERATION_TOLERANCE * limits.a_max),
        )


@compiled
def _are_safe(control: FloatArray, duration: NDArray[np.float64], judge: Judge) -> BoolArray:
    safe = np.empty(len(duration), np.bool_)
    for m in range(len(duration)):
        safe[m] = is_safe(control, duration, m, judge)
    return safe


@compiled_part
def is_safe(control: FloatArray, duration: NDArray[np.float64], m: int, judge: Judge) -> bool:
    """Whether the m-th of splines [D, M, K] and durations [M] is safe."""
    pace = control.dtype.type(1.0 / duration[m])
    path = np.empty((len(judge.band.first), 2), control.dtype)
    for t in range(len(path)):
        x, y = sample_one(control, m, judge.band, t, 1)
        x, y = x * pace, y * pace
        if not np.sqrt(x * x + y * y) <= judge.speed:
            return False
        x, y = sample_one(control, m, judge.band, t, 2)
        x, y = x * pace * pace, y * pace * pace
        if not np.sqrt(x * x + y * y) <= judge.acceleration:
            return False
        path[t, 0], path[t, 1] = sample_one(control, m, judge.band, t, 0)
    apart = moving_clearance(judge.movers, path, duration[m], judge.apart, judge.apart)
    if not apart >= judge.apart:
        return False
    return _clearance_along(judge.grid, path, judge.clearance) >= judge.clearance


def required_clearance(field: GridField, certified_margin: float) -> float:
    """Return the clearance [m] in the field that certifies the margin."""
    return certified_margin + SHARE_OF_CELL * field.resolution


def path_clearance(field: GridField, positions: FloatArray) -> FloatArray:
    """Smallest clearance [m] along each polyline; positions [M, T, D >= 2] -> [M].

    Between two samples the polyline is followed at steps of at most CHECK_STEP.
    """
    positions = np.ascontiguousarray(positions)
    return _path_clearance(Grid.of(field, positions.dtype), positions)


@compiled
def _path_clearance(grid: Grid, positions: FloatArray) -> FloatArray:
    count, steps, _ = positions.shape
    least = np.empty(count, positions.dtype)
    for m in range(count):
        least[m] = look_up(grid, positions[m, steps - 1, 0], positions[m, steps - 1, 1])[0]
        for t in range(1, steps):
            least[m] = _leg_clearance(grid, positions[m], t, False, least[m], -np.inf, 0.0)[0]
    return least


@compiled
def _motion_clearance(grid: Grid, positions: FloatArray) -> FloatArray:
    least = np.empty(len(positions), positions.dtype)
    for m in range(len(positions)):
        least[m] = _clearance_along(grid, positions[m], -np.inf)
    return least


@compiled
def _moving_clearances(
    discs: Discs, positions: FloatArray, duration: NDArray[np.float64]
) -> FloatArray:
    least = np.empty(len(positions), positions.dtype)
    for m in range(len(positions)):
        least[m] = moving_clearance(discs, positions[m], duration[m], -np.inf, np.inf)
    return least


@compiled_part
def _clearance_along(grid: Grid, path: FloatArray, enough: float) -> float:
    """Return the least clearance along samples [T, D] and between them; stop below `enough`.

    The second difference at a sample gives the curvature of the motion there.
    """
    steps, reach = len(path), 0.0
    least = look_up(grid, path[steps - 1, 0], path[steps - 1, 1])[0]
    for t in range(1, steps):
        if not least >= enough:
            break
        least, reach = _leg_clearance(grid, path, t, steps > 2, least, enough, reach)
    return least


@compiled_part
def _leg_clearance(
    grid: Grid, path: FloatArray, t: int, is_bent: bool, least: float, enough: float, reach: float
) -> tuple[float, float]:
    """Return the least of `least` and of the clearance from sample t - 1 up to t, t excluded.

    Where a leg is bent, the second differences of the samples hold at its ends. In between its
    second derivative by the leg's share s is linear, b_0 (1 - s) + b_1 s, which puts it
    s (1 - s) ((2 - s) b_0 + (1 + s) b_1) / 6 beside the chord.

    reach: m of way from sample t - 1 on which nothing can lie lower than `enough`, or if that is
        -inf than `least`: the field is only so steep. Points within it are passed over, as in
        sphere tracing (Hart, 1996). Returned, too: what is left of it at sample t
    """
    x, y, to_x, to_y = path[t - 1, 0], path[t - 1, 1], path[t, 0], path[t, 1]
    along_x, along_y = to_x - x, to_y - y
    length = np.sqrt(along_x * along_x + along_y * along_y)
    rows, columns = grid.values.shape
    far = FAR_OUT * (rows + columns) * grid.resolution
    if not length <= far:
        # So far out of the map the field falls with every metre: an end lies lowest.
        end = look_up(grid, to_x, to_y)[0] if np.isfinite(length) else -np.inf
        return min(least, look_up(grid, x, y)[0], end), 0.0
    b_x = b_y = to_b_x = to_b_y = bulge = along_x * 0
    if is_bent:
        b_x, b_y = _second_difference(path, min(max(t - 1, 1), len(path) - 2))
        to_b_x, to_b_y = _second_difference(path, min(t, len(path) - 2))
        bulge = np.sqrt(max(b_x * b_x + b_y * b_y, to_b_x * to_b_x + to_b_y * to_b_y)) / 8
        if not BULGE < bulge <= far:
            b_x = b_y = to_b_x = to_b_y = bulge = along_x * 0
    pieces = max(np.ceil((length + 2 * bulge) / CHECK_STEP), 1)
    step = (length + 4 * bulge) / pieces
    if reach > pieces * step:
        return least, reach - pieces * step
    for piece in range(int(pieces)):
        if reach <= 0.0:
            s = np.float32(piece) / np.float32(pieces)
            lift = s * (1 - s) / np.float32(6)
            off_x = lift * ((2 - s) * b_x + (1 + s) * to_b_x)
            off_y = lift * ((2 - s) * b_y + (1 + s) * to_b_y)
            here = look_up(grid, x + s * along_x - off_x, y + s * along_y - off_y)[0]
            least = min(least, here)
            reach = (here - (enough if enough > -np.inf else least) - NEAR) / grid.steepest
        reach -= step
    return least, reach


@compiled_part
def _second_difference(path: FloatArray, t: int) -> tuple[float, float]:
    x = path[t - 1, 0] - 2 * path[t, 0] + path[t + 1, 0]
    return x, path[t - 1, 1] - 2 * path[t, 1] + path[t + 1, 1]


def largest_length(vectors: FloatArray) -> FloatArray:
    """Greatest planar length along each trajectory: [M, T, D] -> [M]."""
    return _largest_length(np.ascontiguousarray(vectors))


@compiled
def _largest_length(vectors: FloatArray) -> FloatArray:
    count, steps, _ = vectors.shape
    largest = np.zeros(count, vectors.dtype)
    for m in range(count):
        for t in range(steps):
            x, y = vectors[m, t, 0], vectors[m, t, 1]
            largest[m] = max(largest[m], x * x + y * y)
    return np.sqrt(largest)
