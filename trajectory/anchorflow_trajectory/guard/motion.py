"""Plans on a fine grid of times, with bounds on the motion in between, and what a car can drive.

A plan is the rear axle's poses at given times, in its present frame. Between two poses it moves
straight; the bounds cover the parabola through them too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_trajectory import BoolArray, FloatArray

FINE_S = 0.1
"""s between two times of the test."""
REACH_S = FINE_S / 2
"""s before and after it that each of these times answers for."""
PULL, BRAKE, LATERAL = 5.0, 8.0, 8.0
"""m/s^2: what tyres can do on a dry road."""
CURVATURE = 0.25
"""1/m, of a car that turns about a point 4 m beside the middle of its rear axle."""
TURN_SLACK, SLIP_SLACK = 0.1, 0.2
"""rad and m by which poses of a network may differ from those of a car that does not slip."""
SLIP = 0.1
"""m sideways to a metre along, likewise."""


@dataclass(frozen=True)
class Car:
    """A box about its rear axle: m from there to its front, its rear and either side."""

    front: float
    rear: float
    side: float

    @property
    def middle(self) -> float:
        """m from the rear axle to the middle of the box."""
        return (self.front - self.rear) / 2

    @property
    def half_length(self) -> float:
        """m."""
        return (self.front + self.rear) / 2


@dataclass(frozen=True, eq=False)
class FineMotion:
    """N motions at times [S]; a box grown by the bounds covers all times between its neighbours.

    poses: [N,S,3] m, m, rad
    along, across: [N,S] m by which the car's half length and half width grow
    """

    times: FloatArray
    poses: FloatArray
    along: FloatArray
    across: FloatArray


@dataclass(frozen=True, eq=False)
class Legs:
    """The straight legs between the poses of N plans, from now on.

    times: [T + 1] s; poses: [N,T + 1,3], headings unwrapped
    along, across: [N,T] m moved in the frame of the leg's mean heading; turn: [N,T] rad
    """

    times: FloatArray
    poses: FloatArray
    along: FloatArray
    across: FloatArray
    turn: FloatArray

    @classmethod
    def of(cls, plans: FloatArray, times: FloatArray) -> Legs:
        """Make the legs of plans [N,T,3] at times [T] from the pose (0, 0, 0) at time 0."""
        now = np.zeros_like(plans[:, :1], np.float64)
        poses = np.concatenate([now, plans], 1)
        turn = np.diff(poses[..., 2], axis=1)
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        poses[:, 1:, 2] = turn.cumsum(1)
        moved, mean = np.diff(poses[..., :2], axis=1), poses[:, :-1, 2] + turn / 2
        cos, sin = np.cos(mean), np.sin(mean)
        return cls(
            np.concatenate([[0.0], times]),
            poses,
            moved[..., 0] * cos + moved[..., 1] * sin,
            moved[..., 1] * cos - moved[..., 0] * sin,
            turn,
        )

    @property
    def durations(self) -> FloatArray:
        """[T] s."""
        return np.diff(self.times)

    def can_be_driven(self, speed: float) -> BoolArray:
        """Return [N] whether a car that drives at a speed [m/s] now can follow the poses.

        Accelerations are the changes of the mean speed between the middles of two legs; the first
        is the constant one over the first leg.
        """
        duration = self.durations
        speeds = self.along / duration
        first = (speeds[:, :1] - speed) * 2 / duration[0]
        later = np.diff(speeds, axis=1) * 2 / (duration[1:] + duration[:-1])
        pull = np.concatenate([first, later], 1)
        way = np.abs(self.along)
        possible = (
            (pull >= -BRAKE)
            & (pull <= PULL)
            & (self.along >= -SLIP_SLACK)
            & (np.abs(speeds * self.turn) <= (LATERAL * duration))
            & (np.abs(self.turn) <= CURVATURE * way + TURN_SLACK)
            & (np.abs(self.across) <= SLIP * way + SLIP_SLACK)
        )
        return np.asarray(possible.all(1))

    def fine(self, speed: float, car: Car) -> FineMotion:
        """Return the motion on a grid of FINE_S, and its bounds.

        speed: m/s now, that the first leg's parabola begins with
        """
        steps = int(np.floor(self.times[-1] / FINE_S + 1e-9))
        times = FINE_S * np.arange(steps + 1)
        poses = self._at(times)
        before, after = (self._leg(times + reach) for reach in (-REACH_S, REACH_S))
        cos, sin = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        rates = np.diff(self.poses, axis=1) / self.durations[:, None]
        of_legs = np.concatenate([rates, self._bends(speed)], -1)
        along, across = np.zeros_like(cos), np.zeros_like(cos)
        for leg in (before, after):
            x, y, turn, ahead, aside = np.moveaxis(of_legs[:, leg], -1, 0)
            swing, share = REACH_S * np.abs(turn), self._parabola(times, leg)
            ahead = REACH_S * np.abs(x * cos + y * sin) + car.side * swing + ahead * share
            aside = REACH_S * np.abs(y * cos - x * sin) + car.front * swing + aside * share
            along, across = np.maximum(along, ahead), np.maximum(across, aside)
        return FineMotion(times, poses, along, across)

    def _leg(self, times: FloatArray) -> np.ndarray:
        """Return the legs [S] that hold these times."""
        found = np.searchsorted(self.times, times, side="right") - 1
        return found.clip(0, len(self.times) - 2)

    def _at(self, times: FloatArray) -> FloatArray:
        """Return the poses [N,S,3] at times [S], straight between two."""
        leg = self._leg(times)
        share = ((times - self.times[leg]) / self.durations[leg])[:, None]
        return self.poses[:, leg] * (1 - share) + self.poses[:, leg + 1] * share

    def _parabola(self, times: FloatArray, leg: np.ndarray) -> FloatArray:
        """Return [S] the most of 4 u (1 - u) near these times, u the share of the leg."""
        reach = REACH_S / self.durations[leg]
        share = (times - self.times[leg]) / self.durations[leg]
        nearest = np.clip(0.5, share - reach, share + reach).clip(0.0, 1.0)
        return 4 * nearest * (1 - nearest)

    def _bends(self, speed: float) -> FloatArray:
        """Return [N,T,2] m by which a parabola leaves each leg, along and across its heading.

        An eighth of the larger second difference at its ends.
        """
        duration = self.durations
        rate = np.diff(self.poses[..., :2], axis=1) / duration[:, None]
        first = 2 * (rate[:, :1] - np.array([speed, 0.0]))
        before = np.concatenate([first, np.diff(rate, axis=1)], 1)
        after = np.concatenate([before[:, 1:], np.zeros_like(first)], 1)
        heading = self.poses[:, :-1, 2] + self.turn / 2
        cos, sin = np.cos(heading), np.sin(heading)
        ahead, aside = (
            np.maximum(*(np.abs(x * d[..., 0] + y * d[..., 1]) for d in (before, after)))
            for x, y in ((cos, sin), (-sin, cos))
        )
        return np.stack([ahead, aside], -1) * (duration[:, None] / 8)
