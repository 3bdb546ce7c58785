"""Ways in space and time: before what moves or after it, left of it or right of it.

A disc that moves is a curve in space and time, and a way passes it on one side or on the other, as
a path passes a post: the way's place relative to the disc crosses a ray towards +y, or it does not
(`homotopy`, in the frame of each disc). Whoever has arrived stands at the goal, so that all ways
have common ends in space and time.

The ways of a scene are drawn from a lattice of manoeuvres along each route: to swerve to a side, to
be slow, to hurry and to wait, each at several places. The cheapest of each class is kept
(classes as in de Groot et al., "Topology-Driven Parallel Trajectory Optimization in Dynamic
Environments", IEEE T-RO 41, 2025; lattices as in Werling et al., ICRA 2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.cost.fields import CostFields
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.movers import Discs, place_at
from anchorflow_trajectory.routes.splines import splines_through
from anchorflow_trajectory.spline.basis import PLANE, Ends, SplineBasis, Splines

MOST_WAYS, MOST_OTHERS = 8, 64
END_ROOM, STAY = 0.15, 0.3  # m that what moves leaves to a place to end at, and s for which it does
ASIDE, MOST_ASIDE, DIRECTIONS = 0.15, 3.0, 24  # m, m, and places a ring about a goal that is taken
WHOLE_LATTICE = 2  # routes that get every manoeuvre; the others only slow down and wait
KEYS_SEED = 1
SWERVES = (0.5, 1.0, 1.8)  # m to either side
SWERVE_TIMES = (0.8, 1.6, 2.8, 4.5)  # s at their middle
LEAST_WIDTH, EASED = 0.35, 0.6  # s, of a swerve, and in which it begins and ends
SLOWER = 1.4
WAITS, WAIT_PLACES = (1.0, 2.0, 4.0), (0.0, 0.25, 0.5)  # s, and shares of the time without waits
HURRIED = (0.75, 0.5)  # shares of a horizon that are driven
HURRIED_PLACES = (0.0, 1.0, 0.25, 0.5, 0.75)  # shares of the drive before the wait
SWERVED = 3  # timings


@dataclass(frozen=True, eq=False)
class Ways:
    """R ways, the cheapest first.

    others: the cheapest of what else was drawn, none where nothing moves
    """

    splines: Splines
    others: Splines | None = None


def ways_past(
    along: Splines,
    cost: TrajectoryCost,
    ends: Ends,
    *,
    until: float,
    more: Splines | None = None,
) -> Ways:
    """Return the cheapest way of each class, at most MOST_WAYS.

    along: one spline a route
    cost: its fields tell what moves
    until: s, after which nothing counts
    more: splines that are drawn too
    """
    assert cost.fields.movers is not None
    basis, discs = cost.basis, Discs.of(cost.fields.movers, np.float32)
    drawn, route = _lattice(along, basis, ends, cost.limits)
    if more is not None:
        route = np.append(route, np.full(len(more), len(along)))
        control = np.concatenate([drawn.control, more.control], axis=1)
        drawn = Splines(control, np.append(drawn.duration, more.duration))
    price = cost.value(drawn)
    positions = np.ascontiguousarray(basis.states(drawn)[0][..., PLANE])
    keys = passing_keys(discs, positions, drawn.duration, until) + _keys(len(along) + 1)[route]
    order = np.argsort(price, kind="stable")
    _, first = np.unique(keys[order], return_index=True)
    chosen = order[np.sort(first)[:MOST_WAYS]]
    return Ways(drawn[chosen], drawn[order[:MOST_OTHERS]])


def place_to_end(
    goal: FloatArray,
    start: FloatArray,
    fields: CostFields,
    times: Sequence[float],
    velocity: FloatArray,
    *,
    about: FloatArray,
    within: float,
) -> FloatArray:
    """Return the goal [2] m, or the nearest place to it that is clear of what moves on arrival.

    Among places as near as each other those towards the start [2] come first. The goal stays if no
    place within MOST_ASIDE is clear and at most `within` m from `about` [2].

    fields: of the scene; times: s of arrival, one of which has to do
    velocity: [2] m/s on arrival
    """
    assert fields.movers is not None
    discs = Discs.of(fields.movers, np.float64)
    if not len(discs.radius) or _is_clear(discs, goal[None], times, velocity).any():
        return goal
    back = np.arctan2(*(start - goal)[::-1])
    turns = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    turns = turns[np.argsort(np.abs(turns), kind="stable")] + back
    reach = np.arange(1, round(MOST_ASIDE / ASIDE) + 1) * ASIDE
    offsets = reach[:, None, None] * np.stack([np.cos(turns), np.sin(turns)], -1)
    places = goal + offsets.reshape(-1, 2)
    clear = _is_clear(discs, places, times, velocity).any(1)
    clear &= fields.clearance.sample(*places.astype(np.float32).T) >= fields.clearance.resolution
    clear &= np.linalg.norm(places - about, axis=-1) <= within
    return places[clear.argmax()] if clear.any() else goal


def _is_clear(
    discs: Discs, places: FloatArray, times: Sequence[float], velocity: FloatArray
) -> NDArray[np.bool_]:
    """Return whether what moves keeps END_ROOM from places [P, 2] from [Q] times on: [P, Q].

    It looks STAY s ahead, in which who arrives stands there or goes on at its velocity [2].
    """
    clear = np.ones((len(places), len(times)), np.bool_)
    for q, time in enumerate(times):
        for later in (0.0, 0.5 * STAY, STAY):
            at = np.array([place_at(discs, j, time + later) for j in range(len(discs.radius))])
            apart = np.linalg.norm(places[:, None] + later * velocity - at, axis=-1) - discs.radius
            clear[:, q] &= (apart - discs.growth * (time + later)).min(1) >= END_ROOM
    return clear


def passing_keys(
    discs: Discs, positions: FloatArray, duration: FloatArray, until: float
) -> NDArray[np.uint64]:
    """Return a number for each of the motions [N, T, 2]: equal for those of one class.

    duration: [N] s
    """
    lasting = np.ascontiguousarray(duration, np.float64)
    return _passing_keys(discs, positions, lasting, until, _keys(len(discs.radius)))


@lru_cache(maxsize=64)
def _keys(count: int) -> NDArray[np.uint64]:
    return np.random.default_rng(KEYS_SEED).integers(0, 2**64 - 1, count, np.uint64, endpoint=True)


@compiled
def _passing_keys(
    discs: Discs,
    positions: FloatArray,
    duration: NDArray[np.float64],
    until: float,
    keys: NDArray[np.uint64],
) -> NDArray[np.uint64]:
    count, steps, _ = positions.shape
    found, legs = np.zeros(count, np.uint64), discs.lines.shape[1]
    time, rests = np.empty(steps + legs), legs
    for n in range(count):
        for t in range(steps):
            time[t] = duration[n] * t / (steps - 1)
        for rest in range(rests):
            time[steps + rest] = max(until, duration[n])
            if rest + 1 < rests:
                time[steps + rest] = max((rest + 1) * discs.step, duration[n])
        for j in range(len(keys)):
            x = positions[n, 0, 0] - place_at(discs, j, 0.0)[0]
            for t in range(1, steps + rests):
                at = min(t, steps - 1)
                to_x = positions[n, at, 0] - place_at(discs, j, time[t])[0]
                if (x < 0.0) != (to_x < 0.0):
                    y = positions[n, min(t - 1, steps - 1), 1] - place_at(discs, j, time[t - 1])[1]
                    to_y = positions[n, at, 1] - place_at(discs, j, time[t])[1]
                    if y + (to_y - y) * x / (x - to_x) > 0.0:
                        found[n] += keys[j] if x < 0.0 else np.uint64(0) - keys[j]
                x = to_x
    return found


def _lattice(
    along: Splines, basis: SplineBasis, ends: Ends, limits: MotionLimits
) -> tuple[Splines, NDArray[np.intp]]:
    """Return splines of every manoeuvre, and the index of the route that each follows."""
    paths = np.ascontiguousarray(basis.states(along)[0][..., PLANE])
    drawn, lasting, route = [], [], []
    for index, (path, usual) in enumerate(zip(paths, along.duration.tolist(), strict=True)):
        timing = _timing(usual, limits)
        swerves = _swerves(timing[0, :2].sum(), limits)
        rows = _rows(timing, swerves if index < WHOLE_LATTICE else swerves[:1])
        drawn.append(_driven(path, rows))
        lasting.append(rows[:, 0] + rows[:, 1])
        route.append(np.full(len(rows), index))
    duration = np.concatenate(lasting)
    splines = splines_through(np.concatenate(drawn), basis, ends, duration)
    return splines, np.concatenate(route)


def _timing(usual: float, limits: MotionLimits) -> NDArray[np.float64]:
    """Return [P, 3]: s driven, s waited, and after which share of the drive.

    The first SWERVED go with every swerve.
    """
    horizon = limits.horizon_s
    if horizon is None:
        rows = [(usual, 0.0, 0.0), (SLOWER * usual, 0.0, 0.0)]
        rows += [(usual, wait, place) for wait in WAITS for place in WAIT_PLACES]
    else:
        rows = [(horizon, 0.0, 0.0)]
        for share in HURRIED:
            driven = share * horizon
            rows += [(driven, horizon - driven, place) for place in HURRIED_PLACES]
    return np.array(rows)


def _swerves(duration: float, limits: MotionLimits) -> NDArray[np.float64]:
    """Return [L, 3]: m to the left, and s at the middle and of the width; the first is none."""
    rows = [(0.0, 0.0, 1.0)]
    for by in SWERVES:
        width = max((1.5 * by / limits.a_max) ** 0.5, LEAST_WIDTH)
        for at in SWERVE_TIMES:
            if at < duration:
                rows += [(by, at, width), (-by, at, width)]
    return np.array(rows)


def _rows(timing: NDArray[np.float64], swerves: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return [N, 6], each timing without a swerve, and the first of them with every swerve."""
    straight = np.concatenate([timing, np.repeat(swerves[:1], len(timing), axis=0)], axis=1)
    first, bent = timing[:SWERVED], swerves[1:]
    both = np.concatenate(
        [np.repeat(first, len(bent), axis=0), np.tile(bent, (len(first), 1))], axis=1
    )
    return np.concatenate([straight, both])


@compiled
def _driven(path: FloatArray, rows: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return positions [N, T, 2] of a path [T, 2] that is driven as each of the rows says."""
    steps = len(path)
    driven = np.empty((len(rows), steps, 2), np.float32)
    for n in range(len(rows)):
        moving, waiting, place, by, middle, width = rows[n]
        lasting = moving + waiting
        for t in range(steps):
            time = lasting * t / (steps - 1)
            on_way = min(time, place * moving) + max(time - place * moving - waiting, 0.0)
            at = min(on_way / moving, 1.0) * (steps - 1)
            left = min(int(at), steps - 2)
            share = at - left
            x = path[left, 0] + share * (path[left + 1, 0] - path[left, 0])
            y = path[left, 1] + share * (path[left + 1, 1] - path[left, 1])
            if by != 0.0:
                behind, before = max(left - 2, 0), min(left + 3, steps - 1)
                along_x, along_y = path[before, 0] - path[behind, 0], path[before, 1]
                along_y -= path[behind, 1]
                length = np.sqrt(along_x * along_x + along_y * along_y) + 1e-6
                off, left_s = (time - middle) / width, lasting - time
                aside = by * np.exp(-0.5 * off * off)
                aside *= 1.0 - np.exp(-((time / EASED) ** 2))
                aside *= 1.0 - np.exp(-((left_s / EASED) ** 2))
                x, y = x - aside * along_y / length, y + aside * along_x / length
            driven[n, t, 0], driven[n, t, 1] = x, y
    return driven
