"""The cost and its gradient as compiled loops: the formulas of `trajectory_cost`.

Arrays are [..., LANES], a trajectory a lane; each lane's sums run over its samples in order.
Numbers have the control points' dtype: float32 in the service, float64 in some tests.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.cost.fields import ROOM, Grid, are_alike, find_lanes, read_lanes
from anchorflow_trajectory.movers import Discs
from anchorflow_trajectory.spline.kernels import (
    LANES,
    Band,
    gather_slopes,
    put_lanes,
    sample_lanes,
    take_lanes,
)

DEEP = 0.25  # m of intrusion, about a robot's size, beyond which the hinge grows linearly
MET = 2  # of so many samples one is held against what moves, and counts for all
TINY = 1e-9  # of what is divided by


class Gains(NamedTuple):
    """The weights of the terms, in the control points' dtype; see `trajectory_cost`."""

    time: np.floating
    safety: np.floating
    slow: np.floating
    quick: np.floating
    short: np.floating
    smooth: np.floating
    dear: np.floating
    near: np.floating
    per_s: np.floating
    collision: np.floating
    speed: np.floating
    acceleration: np.floating
    comfort: np.floating
    distance: np.floating
    widening: np.floating
    fading: np.floating
    limit_share: np.floating
    margin: np.floating
    v_max: np.floating
    a_max: np.floating
    jerk_scale: np.floating
    reference_s: np.floating


class Problem(NamedTuple):
    """A `TrajectoryCost` for compiled loops."""

    band: Band
    clearance: Grid
    surcharge: Grid
    movers: Discs | None
    gains: Gains


@compiled
def cost_of_splines(
    problem: Problem, control: FloatArray, duration: FloatArray, style: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """J [M] of control points [D, M, K] and durations [M]; its gradient [D, M, K] and [M].

    style: [3, M], u of safety, energy and smoothness
    """
    dim, count, points = control.shape
    cost, by_duration = np.empty(count, control.dtype), np.empty(count, control.dtype)
    slope = np.empty_like(control)
    taken = np.empty((dim, points, LANES), control.dtype)
    lasting, leaning = np.empty(LANES, control.dtype), np.empty((3, LANES), control.dtype)
    found = np.empty((2, LANES), control.dtype)
    slopes = np.empty_like(taken)
    for begin in range(0, count, LANES):
        lanes = min(LANES, count - begin)
        take_lanes(control, begin, lanes, taken)
        for m in range(lanes):
            lasting[m] = duration[begin + m]
            for k in range(3):
                leaning[k, m] = style[k, begin + m]
        cost_of_lanes(problem, taken, lasting, leaning, lanes, found, slopes, True)
        put_lanes(slopes, begin, lanes, slope)
        for m in range(lanes):
            cost[begin + m], by_duration[begin + m] = found[0, m], found[1, m]
    return cost, slope, by_duration


@compiled_part
def cost_of_lanes(
    problem: Problem,
    control: FloatArray,
    duration: FloatArray,
    style: FloatArray,
    lanes: int,
    found: FloatArray,
    slope: FloatArray,
    is_sloped: bool,
) -> None:
    """Write J of control points [D, K, LANES] and durations [LANES], and its gradient.

    style: [3, LANES], u of safety, energy and smoothness; lanes: how many are in use
    found: [2, LANES], J and its derivative by log duration where the control points stay
    slope: [D, K, LANES], by the control points; left at zero unless is_sloped, in less time
    """
    band, gains, real = problem.band, problem.gains, control.dtype.type
    dim, steps = control.shape[0], len(band.first)
    samples = np.empty((4, dim, LANES), control.dtype)
    ground = np.zeros((2, 3, LANES), control.dtype)
    room = np.empty((ROOM, LANES), control.dtype)
    pull = np.zeros((2, LANES), control.dtype)
    # |p'|, |p''| and |p'''| times these are shares of the limits.
    pace = np.empty((3, LANES), control.dtype)
    gain = np.empty((2, LANES), control.dtype)  # of |p'|^2 and of |p'''|^2
    squares = np.zeros((2, LANES), control.dtype)  # the sums of both
    hinges = np.zeros((2, LANES), control.dtype)  # those of all else, and by log pace
    by_way = real(1.0) / (gains.v_max * gains.reference_s)
    for m in range(lanes):
        once = real(1.0) / duration[m]
        pace[0, m] = once / gains.v_max
        pace[1, m] = once * once / gains.a_max
        pace[2, m] = once * once * once / gains.jerk_scale
        slow = style[0, m] * gains.slow * pace[0, m] * pace[0, m]
        gain[0, m] = slow + style[1, m] * gains.short * by_way * by_way
        gain[1, m] = style[2, m] * gains.smooth * pace[2, m] * pace[2, m]
    slope[:] = real(0.0)
    for t in range(steps):
        sample_lanes(control, lanes, band, t, samples)
        _look_up_ground(problem, samples, lanes, ground, room)
        share = real(t) / real(steps - 1)
        is_met = problem.movers is not None and t % MET == 1
        if is_met:
            _charge_movers(
                problem.movers, gains, style, share, duration, samples, lanes, hinges, pull
            )
        _charge_ground(gains, style, ground, lanes, hinges, samples)
        _charge_motion(gains, pace, gain, by_way, ground, lanes, squares, hinges, samples)
        if is_met:
            _add_to_slopes(problem.movers, pull, lanes, samples)
        if is_sloped:
            gather_slopes(samples, lanes, band, t, slope)
    share = real(1.0) / real(steps)
    for m in range(lanes):
        slow = style[0, m] * gains.slow * pace[0, m] * pace[0, m]
        later = (gains.time + gains.quick * style[1, m]) * duration[m] / gains.reference_s
        jerk = gain[1, m] * squares[1, m]
        found[0, m] = (hinges[0, m] + gain[0, m] * squares[0, m] + jerk) * share + later
        by_pace = real(2.0) * slow * squares[0, m] + real(6.0) * jerk + hinges[1, m]
        found[1, m] = later - by_pace * share
    for d in range(dim):
        for k in range(control.shape[1]):
            for m in range(lanes):
                slope[d, k, m] *= share


@compiled_part
def _look_up_ground(
    problem: Problem, samples: FloatArray, lanes: int, ground: FloatArray, room: FloatArray
) -> None:
    """Write value and slopes of clearance and of the surcharge at the samples, [2, 3, LANES]."""
    x, y = samples[0, 0], samples[0, 1]
    find_lanes(problem.clearance, x, y, lanes, room)
    read_lanes(problem.clearance, lanes, ground[0], room)
    if problem.surcharge.values.size > 0:
        if not are_alike(problem.clearance, problem.surcharge):
            find_lanes(problem.surcharge, x, y, lanes, room)
        read_lanes(problem.surcharge, lanes, ground[1], room)


@compiled_part
def _add_to_slopes(discs: Discs | None, pull: FloatArray, lanes: int, samples: FloatArray) -> None:
    """Add slopes by place [2, LANES] to those that the samples have become."""
    if discs is None:
        return
    for d in range(2):
        for m in range(lanes):
            samples[0, d, m] += pull[d, m]


@compiled_part
def _charge_ground(
    gains: Gains,
    style: FloatArray,
    ground: FloatArray,
    lanes: int,
    hinges: FloatArray,
    samples: FloatArray,
) -> None:
    """Add the cost of how near obstacles the samples lie; their places become its derivatives.

    ground: [2, 3, LANES], value and slopes of clearance and of the surcharge
    """
    real = samples.dtype.type
    for m in range(lanes):
        hard = max(gains.margin - ground[0, 0, m], real(0.0))
        lack = max(real(1.0) - ground[0, 0, m] / gains.comfort, real(0.0))
        deep = min(hard, real(DEEP))  # a deep start must not explode
        safety = style[0, m] * gains.safety
        rate = -real(2.0) * (gains.collision * deep + safety / gains.comfort * lack)
        cost = gains.collision * deep * (hard + hard - deep)
        hinges[0, m] += cost + safety * lack * lack
        samples[0, 0, m] = rate * ground[0, 1, m]
        samples[0, 1, m] = rate * ground[0, 2, m]
    for d in range(2, samples.shape[1]):
        for m in range(lanes):
            samples[0, d, m] = real(0.0)


@compiled_part
def _charge_movers(
    discs: Discs | None,
    gains: Gains,
    style: FloatArray,
    share: float,
    duration: FloatArray,
    samples: FloatArray,
    lanes: int,
    hinges: FloatArray,
    pull: FloatArray,
) -> None:
    """Add the cost of how near what moves the samples lie; write its slopes by place, [2, LANES].

    share: of the duration at which the samples are
    """
    if discs is None:
        return
    real = samples.dtype.type
    legs, far = discs.lines.shape[1], real(np.inf)
    time, comfort = np.empty(LANES, samples.dtype), np.empty(LANES, samples.dtype)
    scale = np.empty((2, LANES), samples.dtype)
    x, y = samples[0, 0], samples[0, 1]
    left, right, low, high, first, last = far, -far, far, -far, far, real(0.0)
    for m in range(lanes):
        time[m] = share * duration[m]
        comfort[m] = real(1.0) / (gains.distance + gains.widening * time[m])
        scale[0, m] = real(MET) * gains.per_s * duration[m]
        scale[1, m] = scale[0, m] * gains.near * (real(1.0) + style[0, m])
        scale[1, m] /= real(1.0) + gains.fading * time[m]
        left, right = min(left, x[m]), max(right, x[m])
        low, high = min(low, y[m]), max(high, y[m])
        first, last = min(first, time[m]), max(last, time[m])
    pull[:] = real(0.0)
    widest = gains.distance + (gains.widening + discs.growth) * last
    for j in range(len(discs.radius)):
        wide = discs.radius[j] + max(widest, gains.margin + discs.growth * last)
        begin, end = 0, 0
        if legs > 1:
            begin = min(int(first / discs.step), legs - 1)
            end = min(int(last / discs.step), legs - 1)
        for leg in range(begin, end + 1):
            x_0, y_0 = discs.lines[j, leg, 0], discs.lines[j, leg, 1]
            speed_x, speed_y = discs.lines[j, leg, 2], discs.lines[j, leg, 3]
            from_s = -far if leg == 0 else real(leg * discs.step)
            until_s = far if leg == legs - 1 else real((leg + 1) * discs.step)
            early, late = max(first, from_s), min(last, until_s)
            if max(x_0 + speed_x * early, x_0 + speed_x * late) < left - wide:
                continue
            if min(x_0 + speed_x * early, x_0 + speed_x * late) > right + wide:
                continue
            if max(y_0 + speed_y * early, y_0 + speed_y * late) < low - wide:
                continue
            if min(y_0 + speed_y * early, y_0 + speed_y * late) > high + wide:
                continue
            line = x_0, y_0, speed_x, speed_y, discs.radius[j], discs.growth
            _charge_mover(
                gains, scale, line, (from_s, until_s), time, comfort, x, y, lanes, hinges, pull
            )


@compiled_part
def _charge_mover(
    gains: Gains,
    scale: FloatArray,
    line: tuple[Any, ...],
    span: tuple[Any, ...],
    time: FloatArray,
    comfort: FloatArray,
    x: FloatArray,
    y: FloatArray,
    lanes: int,
    hinges: FloatArray,
    pull: FloatArray,
) -> None:
    """Add the cost of nearness to a disc on a line: x, y at time 0, speeds, radius and growth.

    span: times from one, up to another, in which it is there
    scale: [2, LANES], factors of collision and of nearness
    time, comfort: [LANES], of the samples, and one over the comfortable distance then
    """
    x_0, y_0, speed_x, speed_y, radius, growth = line
    real = x.dtype.type
    zero, one, two, deepest = real(0.0), real(1.0), real(2.0), real(DEEP)
    cost, later = hinges[0], hinges[1]
    pull_x, pull_y = pull[0], pull[1]
    for m in range(lanes):
        off_x = x[m] - x_0 - speed_x * time[m]
        off_y = y[m] - y_0 - speed_y * time[m]
        apart = np.sqrt(off_x * off_x + off_y * off_y) + real(TINY)
        gap = apart - radius - growth * time[m]
        there = one if (time[m] >= span[0]) and (time[m] < span[1]) else zero
        hard = there * max(gains.margin - gap, zero)
        deep = min(hard, deepest)
        lack = there * max(one - gap * comfort[m], zero)
        touch, near = scale[0, m] * gains.collision, scale[1, m]
        close = near * lack * lack
        charge = touch * deep * (hard + hard - deep) + close
        cost[m] += charge
        rate = -two * (touch * deep + near * comfort[m] * lack) / apart
        pull_x[m] += rate * off_x
        pull_y[m] += rate * off_y
        closing = off_x * speed_x + off_y * speed_y + growth * apart
        widened = two * near * lack * (lack - one) * gains.widening * comfort[m]
        faded = close * gains.fading / (one + gains.fading * time[m])
        later[m] += (rate * closing + widened + faded) * time[m] - charge


@compiled_part
def _charge_motion(
    gains: Gains,
    pace: FloatArray,
    gain: FloatArray,
    by_way: float,
    ground: FloatArray,
    lanes: int,
    squares: FloatArray,
    hinges: FloatArray,
    samples: FloatArray,
) -> None:
    """Add squares of p' and p''', excess over limits and dear ways; samples become derivatives.

    by_way: one over the reference way; ground: as for `_charge_ground`
    """
    dim, real, two = samples.shape[1], samples.dtype.type, samples.dtype.type(2.0)
    for d in range(dim):
        for m in range(lanes):
            squares[0, m] += samples[1, d, m] * samples[1, d, m]
            squares[1, m] += samples[3, d, m] * samples[3, d, m]
            samples[3, d, m] *= two * gain[1, m]
    for d in range(2, dim):
        for m in range(lanes):
            samples[1, d, m] *= two * gain[0, m]
            samples[2, d, m] = real(0.0)
    for order in range(1, 3):
        weight = gains.speed if order == 1 else gains.acceleration
        for m in range(lanes):
            x, y = samples[order, 0, m], samples[order, 1, m]
            size = np.sqrt(x * x + y * y) + real(TINY)
            scale = pace[order - 1, m]
            excess = max(size * scale - gains.limit_share, real(0.0))
            hinges[0, m] += weight * excess * excess
            hinges[1, m] += real(order) * two * weight * excess * size * scale
            pull = two * weight * excess * scale / size
            if order == 1:
                dear = gains.dear * by_way
                rise = dear * (real(1.0) + ground[1, 0, m])
                hinges[0, m] += rise * size
                pull += two * gain[0, m] + rise / size
                samples[0, 0, m] += dear * size * ground[1, 1, m]
                samples[0, 1, m] += dear * size * ground[1, 2, m]
            samples[order, 0, m] = x * pull
            samples[order, 1, m] = y * pull
