"""Routes: which anchors pass obstacles on the same sides, and when to leave the one in use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OCCUPIED, AnchorBatch, CostMap, Obstacles
from anchorflow_client.planner.config import PlannerConfig
from anchorflow_client.planner.request import AnchorInUse

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

BLOCK = 0.1  # m: obstacles nearer to each other than that count as one
FAR = 0.5  # m: a path is on none of the routes from that mean distance on
MIN_PROGRESS = 0.1  # share of v_max at which a robot that is not stuck drives at least


@dataclass(frozen=True, eq=False)
class Routes:
    """The routes of one answer's anchors.

    points: [M, 2] m, at least one in each obstacle
    paths: [N, T, 2] m; of: [N], the route of each, numbered from 0
    signatures: [R, M + L] of the routes
    times: [T] s; movers: [L, T, 2] m, what moves at those times
    """

    points: Array
    paths: Array
    of: NDArray[np.intp]
    signatures: NDArray[np.int8]
    times: Array
    movers: Array

    @classmethod
    def among(
        cls, batch: AnchorBatch, cost_map: CostMap, obstacles: Obstacles | None = None
    ) -> Routes:
        """Group the anchors of one scene on the map [C,H,W] of their request."""
        points = landmarks(cost_map)
        paths = batch.trajectories[..., :2].astype(np.float64)
        times = np.linspace(0.0, batch.durations.max(), paths.shape[1])
        movers = np.zeros((0, len(times), 2)) if obstacles is None else obstacles.places(times)
        counts = signatures(paths, points)
        if len(movers):
            timed = _at_times(paths, batch.durations, times)
            counts = np.concatenate([counts, passings(timed, movers)], axis=1)
        found, of = np.unique(counts, axis=0, return_inverse=True)
        return cls(points, paths, of.reshape(-1), found, times, movers)

    def route_of(self, path: Array, duration_s: float) -> int | None:
        """Return the route of a path [K, 2] in m, whose ends may differ a little.

        It is the route with the path's signature or, if there is none, the route of the nearest
        anchor; None if that is further than FAR away in the mean.
        """
        joined = np.concatenate([self.paths[0, :1], path, self.paths[0, -1:]])
        counts = signatures(joined[None], self.points)
        if len(self.movers):
            timed = _at_times(path[None], np.array([duration_s]), self.times)
            timed[0, 0], timed[0, -1] = self.paths[0, 0], self.paths[0, -1]
            counts = np.concatenate([counts, passings(timed, self.movers)], axis=1)
        same = (self.signatures == counts).all(1)
        if same.any():
            return int(same.argmax())
        length = min(_lengths(path[None])[0, -1], _lengths(self.paths)[:, -1].min())
        at = np.linspace(0.0, length, len(path))
        own, others = _along(path, at), np.stack([_along(each, at) for each in self.paths])
        apart = np.linalg.norm(others - own, axis=-1).mean(1)
        nearest = int(apart.argmin())
        return int(self.of[nearest]) if apart[nearest] <= FAR else None


def landmarks(cost_map: CostMap) -> Array:
    """Return [M, 2] m, the lower left corners of the obstacles: at least one for each obstacle."""
    side = max(1, round(BLOCK / cost_map.resolution))
    occupied = cost_map.occupancy >= OCCUPIED
    rows, columns = (-(-size // side) for size in occupied.shape)
    padded = np.zeros((rows * side, columns * side), np.bool_)
    padded[: occupied.shape[0], : occupied.shape[1]] = occupied
    blocks = padded.reshape(rows, side, columns, side).any((1, 3))
    edged = np.pad(blocks, 1)
    corners = blocks & ~edged[1:-1, :-2] & ~edged[:-2, 1:-1] & ~edged[:-2, :-2]
    row, column = np.nonzero(corners)
    return cost_map.origin + side * cost_map.resolution * (np.stack([column, row], 1) + 0.5)


def signatures(paths: Array, points: Array) -> NDArray[np.int8]:
    """Return [N, M]: how often each path [N, T, 2] crosses the ray up from each point [M, 2].

    From left to right counts 1, from right to left -1. Of two paths with the same ends, one can be
    bent into the other past the points where all these numbers are the same.
    """
    left, right = paths[:, :-1, None], paths[:, 1:, None]
    x, y = points.T
    crossing = (left[..., 0] <= x).astype(np.int8) - (right[..., 0] <= x)
    n, t, m = np.nonzero(crossing)
    a, b = paths[n, t], paths[n, t + 1]
    height = a[:, 1] + (x[m] - a[:, 0]) * (b[:, 1] - a[:, 1]) / (b[:, 0] - a[:, 0])
    counts = np.zeros((len(paths), len(points)), np.int8)
    np.add.at(counts, (n, m), crossing[n, t, m] * (height > y[m]))
    return counts


def passings(paths: Array, movers: Array) -> NDArray[np.int8]:
    """Return [N, L]: the signature of each path [N, T, 2] as seen from each of [L, T, 2] movers.

    Paths and movers are given at the same times. A path that passes before a mover crosses the ray
    up from it another number of times than one that passes behind it.
    """
    x = paths[:, None, :, 0] - movers[..., 0]
    left = x <= 0.0
    n, j, t = np.nonzero(left[..., :-1] != left[..., 1:])
    x_a, x_b = x[n, j, t], x[n, j, t + 1]
    y_a, y_b = (paths[n, k, 1] - movers[j, k, 1] for k in (t, t + 1))
    is_above = y_a - x_a * (y_b - y_a) / (x_b - x_a) > 0.0
    counts = np.zeros((len(paths), len(movers)), np.int8)
    np.add.at(counts, (n, j), np.where(left[n, j, t], is_above, -1 * is_above))
    return counts


def _at_times(paths: Array, durations: Array, times: Array) -> Array:
    """Return [N, T, 2] m, evenly timed paths [N, K, 2] at times [T]; they stand after their end."""
    strides = paths.shape[1] - 1
    at = strides * np.minimum(times / durations[:, None], 1.0)
    low = np.minimum(at.astype(int), strides - 1)
    n = np.arange(len(paths))[:, None]
    before, after = paths[n, low], paths[n, low + 1]
    return before + (at - low)[..., None] * (after - before)


def _lengths(paths: Array) -> Array:
    """Return [N, T] m from the beginning of paths [N, T, 2]."""
    steps = np.linalg.norm(np.diff(paths, axis=1), axis=-1)
    return np.pad(steps.cumsum(1), ((0, 0), (1, 0)))


def _along(path: Array, at: Array) -> Array:
    """Return [K, 2] m, a path [T, 2] at lengths [K] in m from its beginning."""
    length = _lengths(path[None])[0]
    return np.stack([np.interp(at, length, path[:, axis]) for axis in range(2)], 1)


class Commitment:
    """Keeps the robot on its route until another one is better by a margin.

    It holds the anchor in use, and the route that was given up last because the robot got stuck.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self.in_use: AnchorInUse | None = None
        self._barred: AnchorInUse | None = None
        self._config = config

    def choose(self, batch: AnchorBatch, routes: Routes, seen_at: float) -> int:
        """Return the index of the anchor to follow: the best one on the route in use.

        Another route is chosen if no anchor on it is safe, or if the other's best costs less by
        `switch_gain`. The route that was given up is the last choice.
        """
        costs = costs_of(batch)
        safe = batch.arrays.get("safe", np.ones(len(costs), np.bool_))
        eligible = safe if safe.any() else np.ones_like(safe)
        barred = self._route(self._barred, routes, seen_at)
        if barred is not None and (eligible & (routes.of != barred)).any():
            eligible = eligible & (routes.of != barred)
        best = _least(costs, eligible)
        kept = self._route(self.in_use, routes, seen_at)
        own = eligible & (routes.of == kept)
        if not own.any():
            return best
        stays = _least(costs, own)
        worth = costs[best] < costs[stays] - self._config.switch_gain * abs(costs[stays])
        return best if worth else stays

    def give_up(self) -> None:
        """Bar the route in use, and start the next request from noise."""
        self._barred, self.in_use = self.in_use, None

    def reset(self) -> None:
        """Forget the route in use and the barred one."""
        self._barred = self.in_use = None

    @staticmethod
    def _route(anchor: AnchorInUse | None, routes: Routes, now: float) -> int | None:
        if anchor is None or (left := anchor.left(now)) is None:
            return None
        return routes.route_of(left[:, :2], anchor.left_s(now))


def costs_of(batch: AnchorBatch) -> NDArray[np.floating]:
    """Return [N], minus the scores or, if there are none, lengths in m."""
    if "scores" in batch.arrays:
        return -batch.scores.astype(np.float64)
    return np.linalg.norm(np.diff(batch.trajectories[..., :2], axis=1), axis=-1).sum(1)


def _least(costs: NDArray[np.floating], eligible: BoolArray) -> int:
    return int(np.where(eligible, costs, np.inf).argmin())


class Progress:
    """Watches whether a robot with a plan is stuck; times are in s of the planner's clock."""

    def __init__(self, *, stuck_s: float, stuck_m: float) -> None:
        self._stuck_s, self._stuck_m = stuck_s, stuck_m
        self.reset()

    def reset(self) -> None:
        """Start anew: the robot was carried, or has another goal."""
        self._left: Array | None = None
        self._since = 0.0

    def is_stuck(
        self, now: float, place: Array, goal: Array, *, driving: bool, v_max: float = np.inf
    ) -> bool:
        """Return whether it has stayed about one place [2] in m, away from its goal, with a plan.

        v_max: m/s; a slow robot stays nearer to a place that it leaves than `stuck_m`
        """
        about = min(self._stuck_m, MIN_PROGRESS * v_max * self._stuck_s)
        stays = self._left is not None and float(np.linalg.norm(place - self._left)) < about
        there = float(np.linalg.norm(goal - place)) < self._stuck_m
        if not stays or there or not driving:
            self._left, self._since = place, now
        return now - self._since >= self._stuck_s

    def restart(self, now: float) -> None:
        """Give the robot its time again, after its route was changed."""
        self._since = now
