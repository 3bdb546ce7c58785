"""Ways along the lanes from a pose, for rules that predict vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anchorflow_driving.geometry import Array, arc_lengths, at_places, wrap_angle

JOINED_M = 1.0
"""Greatest distance from a lane's end to the start of the next."""
BESIDE_M, ASKEW = 2.5, np.pi / 4
"""Farthest from a lane that is followed, and the greatest angle to it."""
REACH_M = 80.0
"""Length of a way."""
RETURN_M = 30.0
"""Distance over which an offset from the lane fades."""


@dataclass(frozen=True, eq=False)
class Way:
    """A polyline [V, 2], and a vehicle's place along it and to its left, m."""

    line: Array
    along: float
    left: float

    def poses(self, distances: Array) -> Array:
        """Return poses [T, 3] after so many metres; beyond the end straight on."""
        arcs = arc_lengths(self.line)
        places = self.along + distances
        points = at_places(places, arcs, self.line)
        middle = np.clip(places, 0.5, max(arcs[-1] - 0.5, 0.5))
        ends = at_places(middle + 0.5, arcs, self.line)
        begins = at_places(middle - 0.5, arcs, self.line)
        heading = np.arctan2(*(ends - begins).T[::-1])
        over = np.maximum(places - arcs[-1], 0.0)[:, None]
        aside = self.left * np.maximum(0.0, 1 - distances / RETURN_M)[:, None]
        direction = np.stack([np.cos(heading), np.sin(heading)], -1)
        normal = np.stack([-direction[:, 1], direction[:, 0]], -1)
        return np.concatenate([points + over * direction + aside * normal, heading[:, None]], -1)


class LanePaths:
    """The lanes of a map and their successors.

    lines: centrelines [V, 2] in their direction
    """

    def __init__(self, lines: Sequence[Array]) -> None:
        self._lines = [line for line in lines if len(line) > 1]
        starts = np.array([line[0] for line in self._lines]).reshape(-1, 2)
        begins = np.array([_heading(line[:2]) for line in self._lines])
        self._next = [
            np.flatnonzero(
                (np.linalg.norm(starts - line[-1], axis=1) < JOINED_M)
                & (np.abs(wrap_angle(begins - _heading(line[-2:]))) < ASKEW)
            ).tolist()
            for line in self._lines
        ]
        self._points = np.concatenate([*(line[:-1] for line in self._lines), np.zeros((0, 2))])
        steps = [np.diff(line, axis=0) for line in self._lines]
        self._steps = np.concatenate([*steps, np.zeros((0, 2))])
        counts = [len(step) for step in steps]
        self._lane = np.repeat(np.arange(len(steps)), counts)
        self._first = np.concatenate([[0], np.cumsum(counts)]).astype(int)

    def ahead(self, pose: Array, *, most: int) -> list[Way]:
        """Return ways from a pose [3] along the nearest lane in its direction, those with the least
        turn first; none if there is no lane near.
        """
        if not len(self._points):
            return []
        offset = pose[:2] - self._points
        length = np.maximum((self._steps**2).sum(1), 1e-9)
        share = np.clip((offset * self._steps).sum(1) / length, 0, 1)
        apart = offset - share[:, None] * self._steps
        away = np.linalg.norm(apart, axis=1)
        turned = np.abs(wrap_angle(np.arctan2(*self._steps.T[::-1]) - pose[2]))
        away = np.where(turned < ASKEW, away, np.inf)
        nearest = int(away.argmin())
        if away[nearest] > BESIDE_M:
            return []
        lane = int(self._lane[nearest])
        part = nearest - int(self._first[lane])
        along = arc_lengths(self._lines[lane])[part] + share[nearest] * length[nearest] ** 0.5
        x, y = self._steps[nearest] / length[nearest] ** 0.5
        left = float(apart[nearest] @ [-y, x])
        lines = self._from(lane, along + REACH_M)
        lines.sort(key=lambda line: abs(wrap_angle(_heading(line[-2:]) - pose[2])))
        return [Way(line, float(along), left) for line in lines[:most]]

    def _from(self, lane: int, reach: float, passed: frozenset[int] = frozenset()) -> list[Array]:
        """Return every polyline that begins with a lane and is `reach` m long, or ends before.

        passed: lanes that lead to this one; none is driven twice
        """
        line, passed = self._lines[lane], passed | {lane}
        left = reach - arc_lengths(line)[-1]
        if left <= 0 or not self._next[lane]:
            return [line]
        return [
            np.concatenate([line, more])
            for after in self._next[lane]
            if after not in passed
            for more in self._from(after, left, passed)
        ] or [line]


def _heading(step: Array) -> np.float64:
    """Return the direction of a step [2, 2]."""
    return np.arctan2(*(step[1] - step[0])[::-1])
