"""Stretches that are driven in one gear, as splines: the heading is the curve's own direction.

A stretch is a clamped B-spline [K, 2] over u in [0, 1]; driven backwards, the robot looks against
the curve. So the wheels never slip sideways, whatever the control points are. A robot that slides
has its heading as a third component, [K, 3].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.bodies.wheels import BACKWARD, SLIDING
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.cost.fields import Grid, look_up
from anchorflow_trajectory.spline.basis import DEGREE, SplineBasis, spline_basis
from anchorflow_trajectory.spline.kernels import Band

SPACING, LEAST_SPANS, MOST_SPANS = 2.2, 3, 60  # cells of a search from knot to knot
LOOKS = 2  # samples of a span at which the cost of a curve is measured
ENDS = DEGREE - 1  # control points of a clamped end that lie closer
KEPT, LAST = 2, 2  # control points that a start's pose fixes, and an end's
TINY = 1e-9
STIFF = 0.5  # weight of third derivatives by knots beside distances, in a fit
FIRST_MOMENT, SECOND_MOMENT = 0.8, 0.95  # of Adam


class Pull(NamedTuple):
    """What a curve is charged for, and how it is changed.

    room, bend, soft, even, short: weights
    most_bend: 1/m, beyond which bends are charged in earnest; rate: m of a first step
    """

    room: float
    most_bend: float
    bend: float
    soft: float
    even: float
    short: float
    rate: float


def basis_for(length: float, cell: float) -> SplineBasis:
    """Return the basis of a stretch of `length` m, for a search with cells of `cell` m."""
    spans = int(np.clip(np.ceil(length / (SPACING * cell)), LEAST_SPANS, MOST_SPANS))
    return spline_basis(LOOKS * spans + 1, num_control_points=spans + DEGREE, degree=DEGREE)


def fitted(
    points: FloatArray, basis: SplineBasis, gear: int, *, fixed_end: bool, bend: float | None = None
) -> NDArray[np.float64]:
    """Return control points [K, 2] of the curve along poses [P, 3], with its first pose exact.

    fixed_end: the last pose is exact, not only its place; bend: 1/m, the
        curvature at the start, by the way that is driven
    """
    legs = np.hypot(*np.diff(points[:, :2], axis=0).T)
    marks = np.append(0.0, legs.cumsum())
    length, spans = max(float(marks[-1]), TINY), basis.num_control_points - DEGREE
    at = np.linspace(0.0, length, basis.num_samples)
    wanted = _between(points, marks, at, gear)
    count = basis.num_control_points
    control = np.zeros((count, 2))
    reach = gear * length / (DEGREE * spans)
    control[0], control[-1] = points[0, :2], points[-1, :2]
    begin, end = points[0, 2], points[-1, 2]
    ahead = np.array([np.cos(begin), np.sin(begin)])
    control[1] = control[0] + reach * ahead
    held, last = KEPT, LAST if fixed_end else 1
    if bend is not None:
        side = gear * np.array([-ahead[1], ahead[0]]) * length**2 / (6.0 * spans**2)
        control[2] = control[1] + 2.0 * (control[1] - control[0]) + bend * side
        held += 1
    if fixed_end:
        control[-2] = control[-1] - reach * np.array([np.cos(end), np.sin(end)])
    return _free_points(control, wanted, basis, slice(held, count - last))


def slid(points: FloatArray, basis: SplineBasis, first: FloatArray | None) -> NDArray[np.float64]:
    """Return control points [K, 3] of the curve along poses [P, 3] of a robot that slides.

    Both ends are exact. first: [3], the velocity in m/s and the turn per metre at the start
    """
    legs = np.hypot(*np.diff(points[:, :2], axis=0).T)
    marks = np.append(0.0, legs.cumsum())
    length, spans = max(float(marks[-1]), TINY), basis.num_control_points - DEGREE
    at = np.linspace(0.0, length, basis.num_samples)
    wanted = np.stack([np.interp(at, marks, each) for each in points.T], 1)
    control = np.zeros((basis.num_control_points, 3))
    control[0], control[-1], held = points[0], points[-1], 1
    if first is not None:
        step = np.append(first[:2] / max(float(np.hypot(*first[:2])), TINY), first[2])
        control[1] = control[0] + length / (DEGREE * spans) * step
        control[2], held = control[1] + 2.0 * (control[1] - control[0]), 1 + KEPT
    return _free_points(control, wanted, basis, slice(held, -1))


def _free_points(
    control: NDArray[np.float64], wanted: FloatArray, basis: SplineBasis, free: slice
) -> NDArray[np.float64]:
    """Return control points [K, D] with the free ones fitted to samples [S, D], smoothly."""
    matrix, spans = basis.position.astype(np.float64), basis.num_control_points - DEGREE
    jumps = basis.jerk.astype(np.float64) / spans**3
    rows = np.concatenate([matrix, STIFF * jumps])[:, free]
    wanted = np.concatenate([wanted - matrix @ control, -STIFF * jumps @ control])
    control[free] = np.linalg.solve(rows.T @ rows, rows.T @ wanted)
    return control


def _between(
    poses: FloatArray, marks: FloatArray, at: FloatArray, gear: int
) -> NDArray[np.float64]:
    """Return the places [S, 2] `at` m along poses [P, 3], by cubics that have their headings."""
    leg = np.clip(np.searchsorted(marks, at, "right") - 1, 0, len(marks) - 2)
    length = np.maximum(marks[leg + 1] - marks[leg], TINY)
    u = ((at - marks[leg]) / length)[:, None]
    ahead = gear * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], 1)
    first, last = poses[leg, :2], poses[leg + 1, :2]
    leaving, coming = length[:, None] * ahead[leg], length[:, None] * ahead[leg + 1]
    place = first * (1 + 2 * u) * (1 - u) ** 2 + last * (3 - 2 * u) * u**2
    return place + leaving * u * (1 - u) ** 2 - coming * (1 - u) * u**2


@compiled
def value_at(grid: Grid, x: float, y: float) -> float:
    """The value of a field at (x, y) in m, as `look_up` has it inside of the map."""
    u = min(grid.right, max(grid.left, x * grid.cells_per_m - grid.first_x))
    v = min(grid.top, max(grid.bottom, y * grid.cells_per_m - grid.first_y))
    column, row = min(int(u), grid.values.shape[1] - 2), min(int(v), grid.values.shape[0] - 2)
    across, up = u - column, v - row
    low = grid.values[row, column] * (1.0 - across) + grid.values[row, column + 1] * across
    high = grid.values[row + 1, column] * (1.0 - across)
    high += grid.values[row + 1, column + 1] * across
    return low * (1.0 - up) + high * up


@compiled
def settle(
    controls: FloatArray,
    margins: FloatArray,
    band: Band,
    held: int,
    last: int,
    gear: int,
    rim: FloatArray,
    reach: float,
    room: Grid,
    dear: Grid,
    pull: Pull,
    steps: int,
) -> None:
    """Descend on the cost of curves, by Adam, and change their control points [N, K, D].

    margins: [N] m of room that the outline should have
    held, last: control points at both ends that stay
    rim: [Q, 2] points of the outline; reach: m to the farthest
    room: m to the nearest occupied cell; dear: m of detour that a metre is worth
    """
    shape = controls.shape[1:]
    count, slope, first, second = shape[0], np.empty(shape), np.empty(shape), np.empty(shape)
    for n in range(len(controls)):
        control = controls[n]
        first[:], second[:] = 0.0, 0.0
        for step in range(steps):
            slope[:] = 0.0
            _charge_samples(control, margins[n], band, gear, rim, reach, room, dear, pull, slope)
            _charge_shape(control, pull, slope)
            rate = pull.rate * (1.0 - step / steps)
            _descend(control[held : count - last], slope[held:], first, second, rate, step)


@compiled
def _descend(
    control: FloatArray,
    slope: FloatArray,
    first: FloatArray,
    second: FloatArray,
    rate: float,
    step: int,
) -> None:
    """Take a step of Adam on control points [K, D]."""
    decay_first = 1.0 - FIRST_MOMENT ** (step + 1)
    decay_second = 1.0 - SECOND_MOMENT ** (step + 1)
    for k in range(len(control)):
        for d in range(control.shape[1]):
            value = slope[k, d]
            first[k, d] = FIRST_MOMENT * first[k, d] + (1.0 - FIRST_MOMENT) * value
            second[k, d] = SECOND_MOMENT * second[k, d] + (1.0 - SECOND_MOMENT) * value * value
            size = np.sqrt(second[k, d] / decay_second) + TINY
            control[k, d] -= rate * first[k, d] / decay_first / size


@compiled
def _charge_samples(
    control: FloatArray,
    margin: float,
    band: Band,
    gear: int,
    rim: FloatArray,
    reach: float,
    room: Grid,
    dear: Grid,
    pull: Pull,
    slope: FloatArray,
) -> None:
    """Add to slopes [K, D] those of too little room, tight bends and dear ground."""
    width, samples = band.weights.shape[2], len(band.first)
    for t in range(samples):
        first = band.first[t]
        x, y, dx, dy, ddx, ddy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(width):
            px, py = control[first + j, 0], control[first + j, 1]
            x += band.weights[t, 0, j] * px
            y += band.weights[t, 0, j] * py
            dx += band.weights[t, 1, j] * px
            dy += band.weights[t, 1, j] * py
            ddx += band.weights[t, 2, j] * px
            ddy += band.weights[t, 2, j] * py
        speed = np.sqrt(dx * dx + dy * dy) + TINY
        cosine, sine = gear * dx / speed, gear * dy / speed
        if gear == SLIDING:
            heading = _heading_at(control, band, t)
            cosine, sine = np.cos(heading), np.sin(heading)
        share = speed / samples
        # Slopes by place, by heading and by both derivatives.
        gx, gy, turn = _push(x, y, cosine, sine, margin, share, rim, reach, room, pull)
        if dear.values.size:
            _, along_x, along_y = look_up(dear, x, y)
            gx += pull.soft * share * along_x
            gy += pull.soft * share * along_y
        if gear == SLIDING:
            for j in range(width):
                slope[first + j, 2] += band.weights[t, 0, j] * turn
            turn = 0.0
        hx, hy = -turn * dy / (speed * speed), turn * dx / (speed * speed)
        cubed = speed * speed * speed
        bend = (dx * ddy - dy * ddx) / cubed
        force = 2.0 * pull.bend * bend * share * 0.02
        if abs(bend) > pull.most_bend:
            force += 2.0 * pull.bend * (bend - np.sign(bend) * pull.most_bend) * share
        hx += force * (ddy / cubed - 3.0 * bend * dx / (speed * speed))
        hy += force * (-ddx / cubed - 3.0 * bend * dy / (speed * speed))
        kx, ky = -force * dy / cubed, force * dx / cubed
        for j in range(width):
            place, pace = band.weights[t, 0, j], band.weights[t, 1, j]
            curve = band.weights[t, 2, j]
            slope[first + j, 0] += place * gx + pace * hx + curve * kx
            slope[first + j, 1] += place * gy + pace * hy + curve * ky


@compiled
def _push(
    x: float,
    y: float,
    cosine: float,
    sine: float,
    margin: float,
    share: float,
    rim: FloatArray,
    reach: float,
    room: Grid,
    pull: Pull,
) -> tuple[float, float, float]:
    """The slopes by place and by heading of too little room at a pose."""
    gx, gy, turn = 0.0, 0.0, 0.0
    if value_at(room, x, y) >= reach + margin:
        return gx, gy, turn
    for q in range(len(rim)):
        bx = cosine * rim[q, 0] - sine * rim[q, 1]
        by = sine * rim[q, 0] + cosine * rim[q, 1]
        lack = margin - value_at(room, x + bx, y + by)
        if lack > 0.0:
            _, along_x, along_y = look_up(room, x + bx, y + by)
            force = -2.0 * pull.room * min(lack, 2.0 * margin) * share
            gx += force * along_x
            gy += force * along_y
            turn += force * (along_y * bx - along_x * by)
    return gx, gy, turn


@compiled
def _heading_at(control: FloatArray, band: Band, t: int) -> float:
    """The heading at a sample of a curve [K, 3] that has its own."""
    heading = 0.0
    for j in range(band.weights.shape[2]):
        heading += band.weights[t, 0, j] * control[band.first[t] + j, 2]
    return heading


@compiled
def _charge_shape(control: FloatArray, pull: Pull, slope: FloatArray) -> None:
    """Add to slopes [K, D] those of an uneven curve (third differences) and of its length."""
    count = len(control)
    for d in range(control.shape[1]):
        # Clamped ends are uneven by themselves.
        for k in range(ENDS, count - 3 - ENDS):
            jump = control[k + 3, d] - 3.0 * control[k + 2, d] + 3.0 * control[k + 1, d]
            jump = 2.0 * pull.even * (jump - control[k, d])
            slope[k, d] -= jump
            slope[k + 1, d] += 3.0 * jump
            slope[k + 2, d] -= 3.0 * jump
            slope[k + 3, d] += jump
        for k in range(count - 1):
            leg = 2.0 * pull.short * (control[k + 1, d] - control[k, d])
            slope[k, d] -= leg
            slope[k + 1, d] += leg


@compiled
def curve_at(control: FloatArray, band: Band, t: int, gear: int, out: FloatArray) -> None:
    """Write what a curve is at a sample, [8].

    It is x, y, the heading, the course [rad], its curvature [1/m], the turn of the heading [rad/m],
    the change of that [rad/m^2] and |dr/du|.
    """
    first = band.first[t]
    x, y, dx, dy = 0.0, 0.0, 0.0, 0.0
    ddx, ddy, jx, jy = 0.0, 0.0, 0.0, 0.0
    for j in range(band.weights.shape[2]):
        px, py = control[first + j, 0], control[first + j, 1]
        x += band.weights[t, 0, j] * px
        y += band.weights[t, 0, j] * py
        dx += band.weights[t, 1, j] * px
        dy += band.weights[t, 1, j] * py
        ddx += band.weights[t, 2, j] * px
        ddy += band.weights[t, 2, j] * py
        jx += band.weights[t, 3, j] * px
        jy += band.weights[t, 3, j] * py
    speed = np.sqrt(dx * dx + dy * dy) + TINY
    cross = dx * ddy - dy * ddx
    bend = cross / speed**3
    change = (dx * jy - dy * jx) / speed**4 - 3.0 * bend * (dx * ddx + dy * ddy) / speed**3
    course = np.arctan2(dy, dx)
    heading, turn = course, bend
    if gear == BACKWARD:
        heading += np.pi
    if gear == SLIDING:
        heading, turn, change = 0.0, 0.0, 0.0
        for j in range(band.weights.shape[2]):
            heading += band.weights[t, 0, j] * control[first + j, 2]
            turn += band.weights[t, 1, j] * control[first + j, 2] / speed
            change += band.weights[t, 2, j] * control[first + j, 2] / speed**2
        change -= turn * (dx * ddx + dy * ddy) / speed**3
    out[0], out[1], out[2], out[3], out[4] = x, y, heading, course, bend
    out[5], out[6], out[7] = turn, change, speed
