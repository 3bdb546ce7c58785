"""Late plans: plans of a car that begin where it will be when they arrive.

Until then the car does what nobody can change any more: it follows its last plan, or keeps its
speed and yaw rate. A plan is joined to the pose and speed at the end of that. Its path stays where
it is, an offset from it fades over the next metres, and a difference in speed over the plan's time.

Poses are those of the rear axle, in the frame of that axle now.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray

FADE_S, LEAST_FADE_M = 2.0, 4.0
"""An offset from a path fades over the way of 2 s, and over 4 m at least."""
FINE_S = 0.05
"""s between two times at which a car is kept from driving back."""
PROJECTIONS = 3
"""Steps in which the departure is projected onto a path."""
CATCH_UP_S, CATCH_UP = 1.5, 2.0
"""A difference in speed fades in so many s, or in more, so that it takes so many m/s^2."""
LONGEST_S = 1.0
"""The latest departure."""
LEAST_LEG_M = 0.5
"""A shorter last leg says nothing of a curvature."""
SHORTEST = 1e-6
"""m; a shorter leg is a halt."""


@dataclass(frozen=True, eq=False)
class Departure:
    """Where a car will be.

    time: s from now; pose: [3] m, m, rad; speed: m/s
    """

    time: float
    pose: NDArray[np.float64]
    speed: float

    @classmethod
    def at_constant_rates(cls, time: float, *, speed: float, yaw_rate: float) -> Departure:
        """Return the end of an arc that begins now.

        speed: m/s; yaw_rate: rad/s
        """
        turn = yaw_rate * time
        chord = speed * time * float(np.sinc(turn / 2 / np.pi))
        pose = np.array([chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn], np.float64)
        return cls(time, pose, speed)

    @classmethod
    def along(cls, time: float, plan: FloatArray, *, speed: float) -> Departure:
        """Follow a plan that lasts until `time`, beginning wherever the car is beside it now.

        plan: [K,4] time s from now, x, y, heading; speed: m/s now, for a plan that begins later
        """
        if plan[0, 0] > 0:
            plan = np.concatenate([np.zeros((1, 4)), plan])
        times, heading = plan[:, 0], np.unwrap(plan[:, 3])
        places = plan[:, 1:3]
        rates = np.gradient(places, times, axis=0, edge_order=2 if len(times) > 2 else 1)
        if times[0] == 0:
            rates[0] = speed * np.cos(heading[0]), speed * np.sin(heading[0])
        if len(times) == 2:
            rates[1] = 2 * rates[1] - rates[0]  # constant acceleration
        motion = Cubics(times, places.T, rates.T)
        now, then = (
            np.array([*motion.at(np.array([when]))[:, 0], np.interp(when, times, heading)])
            for when in (0.0, time)
        )
        moving = motion.at(np.array([time]), rate=True)[:, 0] @ [np.cos(then[2]), np.sin(then[2])]
        pose = np.asarray(relative(then, now), np.float64)
        return cls(time, pose, max(float(moving), 0.0))


@dataclass(frozen=True, eq=False)
class Cubics:
    """N piecewise cubics through values with rates [N,K] at knots [K]."""

    knots: FloatArray
    values: FloatArray
    rates: FloatArray

    def at(self, places: FloatArray, *, rate: bool = False) -> FloatArray:
        """Return the values, or the rates, [N,M] at places [M] between the knots."""
        leg = np.searchsorted(self.knots, places, side="right") - 1
        leg = leg.clip(0, len(self.knots) - 2)
        span = self.knots[leg + 1] - self.knots[leg]
        u = (places - self.knots[leg]) / span
        first, second = self.values[:, leg], self.values[:, leg + 1]
        slope, last = self.rates[:, leg] * span, self.rates[:, leg + 1] * span
        towards = faded(1 - u, second, -last, rate=rate)
        if rate:
            return (faded(u, first, slope, rate=True) - towards) / span
        return faded(u, first, slope) + towards


def faded(
    share: FloatArray, first: FloatArray, slope: FloatArray, *, rate: bool = False
) -> FloatArray:
    """Return the cubics that fall from `first` with `slope` to 0 at a share of 1, or their rates.

    All three broadcast; slopes and rates are those by the share.
    """
    if rate:
        return first * 6 * (share - 1) * share + slope * (share - 1) * (3 * share - 1)
    return first * (2 * share + 1) * (share - 1) ** 2 + slope * share * (share - 1) ** 2


def relative(poses: FloatArray, frame: FloatArray) -> FloatArray:
    """Return poses [...,3] in the frame of a pose [3]."""
    cos, sin = np.cos(frame[2]), np.sin(frame[2])
    x, y, heading = np.moveaxis(poses - frame, -1, 0)
    return np.stack([cos * x + sin * y, cos * y - sin * x, heading], -1)


def joined(
    plans: FloatArray,
    times: FloatArray,
    *,
    speed: float,
    departure: Departure,
    at: FloatArray | None = None,
) -> FloatArray:
    """Return plans as poses [N,M,3] after a departure, which they pass smoothly.

    Where a plan brakes, the car is ahead of it at the departure, and comes back to it;
    where it pulls away, the car stays behind. After its end a plan keeps its curvature, and its
    speed or its braking.

    plans: [N,T,3] at `times` [T] s from now; speed: m/s with which they begin
    at: [M] s of the poses after the departure; by default `times`
    """
    at = times if at is None else at
    paths = _Paths.through(plans)
    start, aside, turn = paths.beside(departure)
    elapsed = np.arange(0.0, times[-1] + FINE_S / 2, FINE_S)
    ways = _ways(paths, times, speed)
    way = ways.at(departure.time + elapsed)
    behind = start[:, None] - way[:, :1]
    along = departure.speed * np.cos(turn)[:, None]
    faster = along - ways.at(np.array([departure.time]), rate=True)
    span = _catching_up(behind, faster).clip(CATCH_UP_S, times[-1])
    end = np.minimum(behind + faster * span / 2, 0.0)
    way += end + faded(np.minimum(elapsed / span, 1.0), behind - end, faster * span)
    way = np.maximum.accumulate(np.maximum(way, start[:, None]), 1)
    way = np.stack([np.interp(at, elapsed, each) for each in way])
    poses, fade_m = paths.at(way), max(FADE_S * departure.speed, LEAST_FADE_M)
    share = np.minimum((way - start[:, None]) / fade_m, 1.0)
    left, slope = aside[:, None], np.tan(turn)[:, None] * fade_m
    offset, heading = faded(share, left, slope), poses[..., 2].copy()
    poses[..., 0] -= offset * np.sin(heading)
    poses[..., 1] += offset * np.cos(heading)
    poses[..., 2] += np.arctan(faded(share, left, slope, rate=True) / fade_m)
    return poses


def _catching_up(ahead: FloatArray, faster: FloatArray) -> FloatArray:
    """Return the s in which `faded` from m ahead and m/s faster begins with CATCH_UP m/s^2."""
    ahead, faster = np.maximum(ahead, 0.0), np.maximum(faster, 0.0)
    root = np.sqrt(16 * faster**2 + 24 * CATCH_UP * ahead)
    return (4 * faster + root) / (2 * CATCH_UP)


def _ways(paths: _Paths, times: FloatArray, speed: float) -> Cubics:
    """Return m along each path by s from now, to LONGEST_S after its end: they never fall."""
    knots = np.concatenate([[0.0], times, [times[-1] + LONGEST_S]])
    steps = np.diff(knots[:-1])
    legs = np.diff(paths.reach, axis=1) / steps
    rates = np.empty_like(paths.reach)
    around = np.maximum(legs[:, :-1] + legs[:, 1:], SHORTEST)
    rates[:, 1:-1] = 2 * legs[:, :-1] * legs[:, 1:] / around
    braking = np.maximum(legs[:, -2:-1] - legs[:, -1:], 0.0) / steps[-1]
    last = np.maximum(legs[:, -1:] - braking * steps[-1] / 2, 0.0)
    rates[:, 0], rates[:, -1:] = np.clip(speed, 0.0, 3 * legs[:, 0]), last
    moving = np.minimum(LONGEST_S, last / np.maximum(braking, SHORTEST))
    end = paths.reach[:, -1:] + last * moving - braking * moving**2 / 2
    final = last - braking * moving
    return Cubics(knots, np.c_[paths.reach, end], np.c_[rates, final])


@dataclass(frozen=True, eq=False)
class _Paths:
    """N curves through poses, with their headings; they keep their curvature after their ends.

    poses: [N,T + 1,3], headings unwrapped; reach: [N,T + 1] m of each pose along its path
    """

    poses: FloatArray
    reach: FloatArray

    @classmethod
    def through(cls, plans: FloatArray) -> _Paths:
        poses = np.concatenate([np.zeros_like(plans[:, :1]), plans], 1, dtype=np.float64)
        poses[..., 2] = np.unwrap(poses[..., 2], axis=1)
        legs = np.linalg.norm(np.diff(poses[..., :2], axis=1), axis=-1)
        return cls(poses, np.cumsum(np.c_[np.zeros(len(legs)), legs], 1))

    def at(self, way: FloatArray) -> FloatArray:
        """Return the poses [N,M,3] after `way` [N,M] m."""
        last = self.reach.shape[1] - 2
        leg = (self.reach[:, 1:-1, None] <= way[:, None]).sum(1).clip(0, last)
        row = np.arange(len(way))[:, None]
        first, second = self.poses[row, leg], self.poses[row, leg + 1]
        length = self.reach[row, leg + 1] - self.reach[row, leg]
        u = (way - self.reach[row, leg]) / np.maximum(length, SHORTEST)
        beyond = np.maximum(way - self.reach[:, -1:], 0.0)
        u = np.where(length > SHORTEST, u, 1.0).clip(0.0, 1.0)[..., None]
        ahead, back = (
            np.stack([np.cos(h), np.sin(h)], -1) * length[..., None]
            for h in (first[..., 2], second[..., 2])
        )
        place = faded(u, first[..., :2], ahead) + faded(1 - u, second[..., :2], -back)
        heading = first[..., 2:] + (second[..., 2:] - first[..., 2:]) * u
        turn = self.last_curvature[:, None] * beyond
        chord, course = beyond * np.sinc(turn / 2 / np.pi), heading[..., 0] + turn / 2
        place += chord[..., None] * np.stack([np.cos(course), np.sin(course)], -1)
        return np.concatenate([place, heading + turn[..., None]], -1)

    @property
    def last_curvature(self) -> FloatArray:
        """[N] 1/m of the last legs."""
        length = self.reach[:, -1] - self.reach[:, -2]
        turn = self.poses[:, -1, 2] - self.poses[:, -2, 2]
        return np.where(length > LEAST_LEG_M, turn / np.maximum(length, LEAST_LEG_M), 0.0)

    def beside(self, departure: Departure) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return m along each path [N], m to the left of it and rad from its heading there."""
        way = np.full((len(self.poses), 1), np.hypot(*departure.pose[:2]))
        for _ in range(PROJECTIONS):
            way = np.maximum(way + self._seen_from(way, departure)[0][:, None], 0.0)
        _, aside, turn = self._seen_from(way, departure)
        return way[:, 0], aside, turn

    def _seen_from(self, way: FloatArray, departure: Departure) -> FloatArray:
        """Return the departure [3,N] ahead, to the left and turned, from `way` [N,1] m on."""
        x, y, heading = self.at(way)[:, 0].T
        ahead, aside = departure.pose[0] - x, departure.pose[1] - y
        cos, sin = np.cos(heading), np.sin(heading)
        seen = [ahead * cos + aside * sin, aside * cos - ahead * sin, departure.pose[2] - heading]
        return np.stack(seen)
