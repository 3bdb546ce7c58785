"""Which centrelines a recorded vehicle followed (Viterbi over the lanes of its frames)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anchorflow_driving.geometry import Array, arc_lengths, at_places, wrap_angle
from anchorflow_driving.log import VEHICLE, DrivingLog
from anchorflow_driving.route import ROUTE_SIGMA, blended, places_on, smooth_line
from anchorflow_driving.window_choice import Driven

SAMPLE = 0.5
"""m between the points of a lane that are looked at."""
REACH, TURN = 3.5, np.deg2rad(60.0)
"""m and rad, beyond which a lane is none that a vehicle drives on."""
ASIDE, ASKEW = 1.0, 0.5
"""m and rad that cost 1."""
CHANGE = 12.0
"""Cost of going on in a lane that does not follow."""
HOPS = 3
"""Lanes that a vehicle may pass between two frames."""
BEYOND = 60.0
"""m by which the line extends past the record."""


class LaneFollowing:
    """The lanes of a log, to match its tracks with."""

    def __init__(self, log: DrivingLog) -> None:
        self._centres = log.polylines("centre")
        self._following = _following(len(self._centres), log.lane_edges)
        parts = [_sampled(centre) for centre in self._centres]
        self._points = np.concatenate([points for points, _ in parts])
        self._heading = np.concatenate([heading for _, heading in parts])
        self._lane = np.repeat(np.arange(len(parts)), [len(points) for points, _ in parts])
        self._tree = KDTree(self._points)
        self._reached = [_reachable(self._following, lane) for lane in range(len(parts))]

    def driven(self, track: int, states: Array) -> Driven | None:
        """The line that a track [F, 5] followed; None where it left the lanes or was not seen.

        A track with gaps is not followed.
        """
        present = np.flatnonzero(np.isfinite(states[:, 0]))
        if len(present) < 2 or np.ptp(present) != len(present) - 1:
            return None
        seen = states[present]
        near = [self._near(state) for state in seen]
        if not all(near):
            return None
        lanes = self._matched(near)
        points = [self._points[found[lane][1]] for found, lane in zip(near, lanes, strict=True)]
        ahead = self._ahead(lanes[-1], points[-1])
        line = smooth_line(
            blended(np.concatenate([np.array(points), ahead]), seen[:, :2]), sigma=ROUTE_SIGMA
        )
        place = np.full(len(states), np.nan)
        place[present] = places_on(line, seen[:, :2])
        return Driven(track, VEHICLE, line, place, np.full(len(states), np.nan))

    def _near(self, state: Array) -> dict[int, tuple[float, int]]:
        """Cost and nearest point by lane, of the lanes that a vehicle may be in."""
        found: dict[int, tuple[float, int]] = {}
        for index in self._tree.query_ball_point(state[:2], REACH):
            askew = abs(float(wrap_angle(self._heading[index] - state[2])))
            if askew > TURN:
                continue
            aside = float(np.linalg.norm(self._points[index] - state[:2]))
            cost = (aside / ASIDE) ** 2 + (askew / ASKEW) ** 2
            lane = int(self._lane[index])
            if lane not in found or cost < found[lane][0]:
                found[lane] = cost, index
        return found

    def _matched(self, near: Sequence[dict[int, tuple[float, int]]]) -> list[int]:
        """The lane of every frame, such that costs and changes together are least."""
        cost = {lane: own for lane, (own, _) in near[0].items()}
        before: list[dict[int, int]] = []
        for found in near[1:]:
            best: dict[int, int] = {}
            later: dict[int, float] = {}
            for lane, (own, _) in found.items():
                came = min(cost, key=lambda last: cost[last] + self._change(last, lane))
                best[lane] = came
                later[lane] = cost[came] + self._change(came, lane) + own
            before.append(best)
            cost = later
        lanes = [min(cost, key=cost.__getitem__)]
        for best in reversed(before):
            lanes.append(best[lanes[-1]])
        return lanes[::-1]

    def _change(self, last: int, lane: int) -> float:
        return 0.0 if lane == last or lane in self._reached[last] else CHANGE

    def _ahead(self, lane: int, point: Array) -> Array:
        """Points after a point of a lane, along what bends least."""
        centre = self._centres[lane]
        nearest = int(np.linalg.norm(centre - point, axis=1).argmin())
        parts, length = [centre[nearest + 1 :]], 0.0
        while length < BEYOND and self._following[lane]:
            lane = min(self._following[lane], key=lambda next_: _bend(self._centres[next_]))
            parts.append(self._centres[lane])
            length += float(np.linalg.norm(np.diff(parts[-1], axis=0), axis=1).sum())
        return np.concatenate(parts)


def _following(lanes: int, edges: NDArray[np.int32]) -> list[list[int]]:
    following: list[list[int]] = [[] for _ in range(lanes)]
    for first, second in edges.tolist():
        following[first].append(second)
    return following


def _reachable(following: list[list[int]], lane: int) -> set[int]:
    reached, last = set(), {lane}
    for _ in range(HOPS):
        last = {later for each in last for later in following[each]}
        reached |= last
    return reached


def _sampled(centre: Array) -> tuple[Array, Array]:
    """Points of a centreline every SAMPLE m, and its heading there."""
    length = arc_lengths(centre)
    at = np.linspace(0.0, length[-1], max(2, int(np.ceil(length[-1] / SAMPLE)) + 1))
    points = at_places(at, length, centre)
    slope = np.gradient(points, axis=0)
    return points, np.arctan2(slope[:, 1], slope[:, 0])


def _bend(centre: Array) -> float:
    step = np.diff(centre, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    return abs(float(heading[-1] - heading[0]))
