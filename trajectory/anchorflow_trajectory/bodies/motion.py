"""Motions along the stretches of a way: its table by arc length, a law of time, and the poses.

A way is a table of rows, one stretch after the other: m (or, on the spot, rad) along the stretch,
x, y, heading, course [rad] and its curvature [1/m], the turn of the heading [rad/m] and its change
[rad/m^2]. On wheels the course is the heading, or its reverse. Between rows everything is linear.

The law of a stretch speeds up and brakes as limits allow, averaged over a short window of time. The
average keeps speeds and accelerations within the same limits and bounds the jerk, and it stays in
closed form: the averaged speed is a difference of places, the averaged place one of their integral.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.bodies.curves import curve_at, value_at
from anchorflow_trajectory.bodies.outline import Ground, touches
from anchorflow_trajectory.bodies.wheels import BACKWARD, TURNING
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.cost.fields import Grid
from anchorflow_trajectory.movers import Discs, place_at
from anchorflow_trajectory.spline.kernels import Band

ALONG, X, Y, HEADING, COURSE, BEND, TURN, CHANGE = range(8)
COLUMNS = 8
PULLING, SIDEWAYS = 0.8, 0.6  # shares of a_max: along the way, and across in bends
SPIN_SHARE, SPIN_S = 0.93, 0.4  # of omega_max, and s in which a turn reaches it
TIGHT = 1e-6  # 1/m
STEEPEST = np.sqrt(2.0)  # most that a field of distances changes, a metre, between its cells
CLOSE = 0.02  # m that any point of the outline moves between two poses that are tested


class Limits(NamedTuple):
    """v_max [m/s], a_max [m/s^2], omega_max [rad/s]; most_bend: 1/m; window: s of the average."""

    v_max: float
    a_max: float
    omega_max: float
    most_bend: float
    window: float


class Law(NamedTuple):
    """Places [R] m, speeds [R] m/s, times [R] s and integrals of the place by time [R] m s."""

    places: NDArray[np.float64]
    speeds: NDArray[np.float64]
    times: NDArray[np.float64]
    integrals: NDArray[np.float64]


@compiled
def tabulate(control: FloatArray, band: Band, gear: int, heading: float, rows: FloatArray) -> None:
    """Write the tables [N, R, 8] of curves [N, K, D], sampled R times; heading: about the first."""
    out = np.empty(8)
    for n in range(len(control)):
        along, before, pace = 0.0, heading, 0.0
        course = heading + (np.pi if gear == BACKWARD else 0.0)
        for t in range(rows.shape[1]):
            curve_at(control[n], band, t, gear, out)
            if t:
                along += 0.5 * (pace + out[7]) / (rows.shape[1] - 1)
            pace = out[7]
            before += (out[2] - before + np.pi) % (2.0 * np.pi) - np.pi
            course += (out[3] - course + np.pi) % (2.0 * np.pi) - np.pi
            rows[n, t, ALONG], rows[n, t, X], rows[n, t, Y] = along, out[0], out[1]
            rows[n, t, HEADING], rows[n, t, COURSE], rows[n, t, BEND] = before, course, out[4]
            rows[n, t, TURN], rows[n, t, CHANGE] = out[5], out[6]


@compiled
def certify(
    rows: FloatArray,
    gears: NDArray[np.int64],
    begins: NDArray[np.int64],
    ground: Ground,
    corners: FloatArray,
    reach: float,
    rim: FloatArray,
    room: Grid,
    clear: float,
    most_bend: float,
    whole: bool,
) -> tuple[BoolArray, NDArray[np.float64]]:
    """Whether ways [N, R, 8] touch nothing and bend no tighter than allowed, and their room [N] m.

    corners: [K, 2] of the outline, with the margin that lies between two poses that are tested
    rim: [Q, 2] points of the outline itself, from which the room is measured
    clear: m of room at the rim with which a body that touched nothing before touches nothing
    whole: whether a way that is not safe is followed to its end, as its room demands
    """
    count = len(rows)
    safe, least = np.ones(count, np.bool_), np.full(count, np.inf)
    spans = np.empty((2, ground.room.shape[0]))
    for n in range(count):
        begin, bound = True, -np.inf  # m that the room of a row has at least
        for g in range(len(gears)):
            for t in range(begins[g], begins[g + 1]):
                if not (safe[n] or whole):
                    break
                row, before = rows[n, t], rows[n, max(t - 1, begins[g])]
                free = known = max(clear, least[n])
                bound -= STEEPEST * _moved(before, row, reach)
                if t == begins[g] or bound < known:
                    free = bound = _room(rim, reach, room, row, known)
                least[n] = min(least[n], free)
                safe[n] &= gears[g] == TURNING or abs(row[BEND]) <= most_bend
                if safe[n] and (begin or free < clear):
                    safe[n] = not _touched(ground, corners, reach, before, row, spans)
                begin = False
    return safe, least


@compiled
def _moved(before: FloatArray, row: FloatArray, reach: float) -> float:
    """Return m that no point of an outline moves further than, from one row [8] to the next."""
    moved = np.hypot(row[X] - before[X], row[Y] - before[Y])
    return moved + abs(row[HEADING] - before[HEADING]) * reach


@compiled
def _touched(
    ground: Ground,
    corners: FloatArray,
    reach: float,
    before: FloatArray,
    row: FloatArray,
    spans: FloatArray,
) -> bool:
    """Whether an outline touches something on the way from one row [8] to the next."""
    parts = max(1, int(np.ceil(_moved(before, row, reach) / CLOSE)))
    pose = np.empty(3)
    for part in range(parts):
        share = (part + 1.0) / parts
        for k in range(3):
            pose[k] = before[X + k] + share * (row[X + k] - before[X + k])
        if touches(ground, corners, reach, pose, spans):
            return True
    return False


@compiled
def _room(rim: FloatArray, reach: float, room: Grid, row: FloatArray, known: float) -> float:
    """m from the outline [Q, 2] at a row [8] to the nearest occupied cell, or less beyond known."""
    about = value_at(room, row[X], row[Y]) - reach
    if about > known:
        return about
    cosine, sine, least = np.cos(row[HEADING]), np.sin(row[HEADING]), np.inf
    for q in range(len(rim)):
        x = row[X] + cosine * rim[q, 0] - sine * rim[q, 1]
        y = row[Y] + sine * rim[q, 0] + cosine * rim[q, 1]
        least = min(least, value_at(room, x, y))
    return least


@compiled
def law_along(
    rows: FloatArray, turning: bool, limits: Limits, pace: float, begin: float, end: float
) -> tuple[Law, bool]:
    """The law along a stretch [R, 8] between two speeds, and whether it can be kept.

    pace: share of the highest speed; begin, end: m/s
    """
    count, window = len(rows), limits.window
    length = rows[count - 1, ALONG]
    shorter = max(length - 0.5 * window * (begin + end), 0.1 * length)
    places = rows[:, ALONG] * (shorter / max(length, 1e-12))
    pull = PULLING * limits.a_max
    if turning:
        pull = limits.omega_max / SPIN_S
        bounds = np.full(count, SPIN_SHARE * limits.omega_max)
    else:
        bounds = _highest_speeds(rows, limits)
    speeds = np.minimum(bounds, pace * (limits.omega_max if turning else limits.v_max))
    # Who is faster than its pace slows down to it.
    for k in range(count):
        slowing = np.sqrt(max(begin**2 - 2.0 * pull * places[k], 0.0))
        speeds[k] = max(speeds[k], min(slowing, bounds[k]))
    keeps = begin <= speeds[0] * 1.1 + 1e-3
    speeds[0], speeds[count - 1] = begin, min(end, speeds[count - 1])
    for k in range(count - 2, 0, -1):
        ahead = speeds[k + 1] ** 2 + 2.0 * pull * (places[k + 1] - places[k])
        speeds[k] = min(speeds[k], np.sqrt(ahead))
    reached = speeds[1] ** 2 + 2.0 * pull * (places[1] - places[0])
    keeps &= begin**2 <= 1.2 * reached + 1e-6
    for k in range(1, count):
        before = speeds[k - 1] ** 2 + 2.0 * pull * (places[k] - places[k - 1])
        speeds[k] = min(speeds[k], np.sqrt(before))
    times, integrals = np.zeros(count), np.zeros(count)
    for k in range(1, count):
        mean = max(0.5 * (speeds[k] + speeds[k - 1]), 1e-6)
        lasts = (places[k] - places[k - 1]) / mean
        times[k] = times[k - 1] + lasts
        # The place is a parabola between two rows.
        change = (speeds[k] - speeds[k - 1]) * lasts * lasts / 6.0
        integrals[k] = integrals[k - 1] + lasts * (places[k - 1] + 0.5 * speeds[k - 1] * lasts)
        integrals[k] += change
    return Law(places, speeds, times, integrals), keeps


@compiled
def _highest_speeds(rows: FloatArray, limits: Limits) -> NDArray[np.float64]:
    """The highest speeds [R] in the bends of a stretch [R, 8] that is driven.

    Each holds for the bends within half a window too, since the law is averaged.
    """
    count, half = len(rows), 0.5 * limits.window * limits.v_max
    speeds = np.empty(count)
    # Rows up to `high` that may be the tightest of a window to come, the tightest first.
    tightest, first, last, high = np.empty(count, np.int64), 0, 0, -1
    for k in range(count):
        while high < count - 1 and (high < k or rows[high, ALONG] < rows[k, ALONG] + half):
            high += 1
            while last > first and _hardest(rows[tightest[last - 1]]) <= _hardest(rows[high]):
                last -= 1
            tightest[last] = high
            last += 1
        while rows[tightest[first], ALONG] < rows[k, ALONG] - half:
            first += 1
        bend = max(_hardest(rows[tightest[first]]), TIGHT)
        in_turns = SPIN_SHARE * limits.omega_max / bend
        speeds[k] = min(limits.v_max, in_turns, np.sqrt(SIDEWAYS * limits.a_max / bend))
    return speeds


@compiled
def _hardest(row: FloatArray) -> float:
    """1/m, by the bend of a row [8] or, if that is more, by the turn of its heading."""
    return max(abs(row[BEND]), abs(row[TURN]))


@compiled
def _read(law: Law, time: float) -> tuple[float, float, float]:
    """Place [m], speed [m/s] and the integral of the place [m s] at a time, before or after too."""
    places, speeds, times, integrals = law
    last = len(times) - 1
    if time <= 0.0:
        return speeds[0] * time, speeds[0], 0.5 * speeds[0] * time * time
    if time >= times[last]:
        later = time - times[last]
        place = places[last] + speeds[last] * later
        return place, speeds[last], integrals[last] + 0.5 * (places[last] + place) * later
    k = min(np.searchsorted(times, time, "right") - 1, last - 1)
    later, lasts = time - times[k], max(times[k + 1] - times[k], 1e-12)
    pull = (speeds[k + 1] - speeds[k]) / lasts
    place = places[k] + later * (speeds[k] + 0.5 * pull * later)
    integral = integrals[k] + later * (places[k] + later * (0.5 * speeds[k] + pull * later / 6.0))
    return place, speeds[k] + pull * later, integral


@compiled
def averaged(law: Law, window: float, time: float) -> tuple[float, float, float]:
    """Place [m], speed and acceleration at a time [s] from the start of a stretch on."""
    before, after = _read(law, time - window), _read(law, time)
    shift = 0.5 * window * law.speeds[0]
    place = (after[2] - before[2]) / window + shift
    return place, (after[0] - before[0]) / window, (after[1] - before[1]) / window


@compiled
def drive(
    rows: FloatArray,
    gears: NDArray[np.int64],
    begins: NDArray[np.int64],
    limits: Limits,
    paces: FloatArray,
    waits: FloatArray,
    begin: float,
    end: float,
    lasts: float,
    motion: FloatArray,
    durations: FloatArray,
) -> BoolArray:
    """Drive along ways [N, R, 8]; returns whether each can be kept from its first speed on.

    Args:
        paces: [N] shares of the highest speed; waits: [N] s at rest before.
        begin, end: m/s along the first stretch and the last.
        lasts: s that every motion spans, with a rest at its end; 0: each its own.
        motion: [3, N, T, 3], written: poses, their velocities and accelerations.
        durations: [N] s, written.
    """
    count, steps, stretches = len(rows), motion.shape[2], len(gears)
    keeps = np.ones(count, np.bool_)
    for n in range(count):
        laws = [
            law_along(
                rows[n, begins[g] : begins[g + 1]],
                gears[g] == TURNING,
                limits,
                paces[n],
                begin if g == 0 else 0.0,
                end if g == stretches - 1 else 0.0,
            )
            for g in range(stretches)
        ]
        total = waits[n]
        for law, kept in laws:
            keeps[n] &= kept
            total += law.times[-1] + limits.window
        durations[n] = lasts if lasts > 0.0 else total
        g, since = 0, waits[n]
        for t in range(steps):
            time = durations[n] * t / (steps - 1)
            while g < stretches - 1 and time > since + laws[g][0].times[-1] + limits.window:
                since += laws[g][0].times[-1] + limits.window
                g += 1
            law = laws[g][0]
            within = min(max(time - since, 0.0), law.times[-1] + limits.window)
            place, speed, pull = averaged(law, limits.window, within)
            if not -1e-9 <= time - since <= law.times[-1] + limits.window + 1e-9:
                speed, pull = 0.0, 0.0
            _pose(rows[n, begins[g] : begins[g + 1]], gears[g], place, speed, pull, motion[:, n, t])
    return keeps


@compiled
def _pose(
    rows: FloatArray, gear: int, place: float, speed: float, pull: float, out: FloatArray
) -> None:
    """Write the pose, velocity and acceleration [3, 3] at a place of a stretch [R, 8]."""
    last = len(rows) - 1
    place = min(max(place, 0.0), rows[last, ALONG])
    k = min(max(np.searchsorted(rows[:, ALONG], place, "right") - 1, 0), last - 1)
    share = (place - rows[k, ALONG]) / max(rows[k + 1, ALONG] - rows[k, ALONG], 1e-12)
    for d in range(3):
        out[0, d] = rows[k, X + d] + share * (rows[k + 1, X + d] - rows[k, X + d])
    if gear == TURNING:
        side = 1.0 if rows[last, HEADING] >= rows[0, HEADING] else -1.0
        out[1:] = 0.0
        out[1, 2], out[2, 2] = side * speed, side * pull
        return
    course, bend, turn, change = rows[k, COURSE:] + share * (
        rows[k + 1, COURSE:] - rows[k, COURSE:]
    )
    cosine, sine = np.cos(course), np.sin(course)
    across = speed * speed * bend
    out[1, 0], out[1, 1], out[1, 2] = speed * cosine, speed * sine, speed * turn
    out[2, 0], out[2, 1] = pull * cosine - across * sine, pull * sine + across * cosine
    out[2, 2] = turn * pull + change * speed * speed


@compiled
def room_to_movers(
    poses: FloatArray, durations: FloatArray, discs: Discs, corners: FloatArray, reach: float
) -> NDArray[np.float64]:
    """Return [N] m, a lower bound of the room between an outline and moving discs, all the way.

    poses: [N, T, 3], straight between two; durations: [N] s; corners: [K, 2], counter-clockwise
    """
    least = np.full(len(poses), np.inf)
    for n in range(len(poses)):
        stride = durations[n] / (poses.shape[1] - 1)
        for t in range(1, poses.shape[1]):
            first, last = poses[n, t - 1], poses[n, t]
            moved = np.hypot(last[0] - first[0], last[1] - first[1])
            moved += abs(last[2] - first[2]) * reach
            for j in range(len(discs.radius)):
                at_x, at_y = place_at(discs, j, (t - 1) * stride)
                to_x, to_y = place_at(discs, j, t * stride)
                both = moved + np.hypot(to_x - at_x, to_y - at_y)
                radius = discs.radius[j] + discs.growth * t * stride
                away = np.hypot(first[0] - at_x, first[1] - at_y)
                if away - both - reach - radius > least[n]:
                    continue
                parts = max(1, int(np.ceil(both / CLOSE)))
                for part in range(parts + 1):
                    share = part / parts
                    x = at_x + share * (to_x - at_x) - first[0] - share * (last[0] - first[0])
                    y = at_y + share * (to_y - at_y) - first[1] - share * (last[1] - first[1])
                    heading = first[2] + share * (last[2] - first[2])
                    free = _beside(corners, np.cos(heading), np.sin(heading), x, y)
                    least[n] = min(least[n], free - radius - 0.5 * both / parts)
    return least


@compiled
def _beside(corners: FloatArray, cosine: float, sine: float, x: float, y: float) -> float:
    """m from a convex outline [K, 2] to a point beside its robot, or less at a corner."""
    ahead, left = cosine * x + sine * y, cosine * y - sine * x
    most, count = -np.inf, len(corners)
    for k in range(count):
        edge_x = corners[(k + 1) % count, 0] - corners[k, 0]
        edge_y = corners[(k + 1) % count, 1] - corners[k, 1]
        out = edge_y * (ahead - corners[k, 0]) - edge_x * (left - corners[k, 1])
        most = max(most, out / np.hypot(edge_x, edge_y))
    return most
