"""The centreline that a simulated driver followed, and goes on to follow."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.simulation.courses import SPACING, smooth_line
from anchorflow_driving.simulation.recording import VehicleRecord
from anchorflow_driving.simulation.road_net import NetLane, RoadNet

Array = NDArray[np.float64]

BLEND = 12.0
"""m before and after a change of lanes that the route takes for it."""
SIDESTEP = 1.0
"""m between two frames that only a change of lanes explains, beyond what was driven."""
BEYOND = 60.0
"""m that a route goes on past the record."""


def followed_line(net: RoadNet, vehicle: VehicleRecord) -> tuple[Array, Array]:
    """The smoothed centreline [V, 2], and where on it [F] the front bumper was, m."""
    front = np.asarray(vehicle.front)
    points = [
        _on_lane(net, name, [position for _, position in along], front[begin : begin + len(along)])
        for name, begin, along in _runs(vehicle.lane)
    ]
    last = net.lanes.get(vehicle.lane[-1][0])
    onward = _onward(net, last, vehicle) if last else np.zeros((0, 2))
    line = _blended(np.concatenate([*points, onward]), front, len(front))
    smoothed = smooth_line(line, sigma=1.5)
    return smoothed, _places(smoothed, front)


def _runs(lane: list[tuple[str, float]]) -> Iterator[tuple[str, int, list[tuple[str, float]]]]:
    """Frames on one lane: its name, the first of them, and what was noted."""
    begin = 0
    for name, group in groupby(lane, key=lambda noted: noted[0]):
        along = list(group)
        yield name, begin, along
        begin += len(along)


def _on_lane(net: RoadNet, name: str, positions: list[float], front: Array) -> Array:
    """[F, 2] of the lane's centreline; where SUMO names none of ours, where the vehicle was."""
    lane = net.lanes.get(name)
    return lane.points(np.array(positions)) if lane else front


def _onward(net: RoadNet, lane: NetLane, vehicle: VehicleRecord) -> Array:
    """Points after the last frame, along the lanes that lead to the next edges of the route."""
    _, position = vehicle.lane[-1]
    ahead = lane.arc_length > position / lane.sumo_length * lane.arc_length[-1]
    parts, length = [lane.centre[ahead]], lane.sumo_length - position
    route = vehicle.route[vehicle.on_route :]
    while length < BEYOND:
        follower = _follower(net, lane, route)
        if follower is None:
            break
        lane = follower
        parts.append(lane.centre)
        length += lane.arc_length[-1]
    return np.concatenate(parts)


def _follower(net: RoadNet, lane: NetLane, route: list[str]) -> NetLane | None:
    following = [net.lanes[name] for name in net.following[lane.name]]
    if not following or lane.in_junction:
        return following[0] if following else None
    later = route[route.index(lane.edge) + 1 :] if lane.edge in route else []
    if not later:
        return None
    leads = [next_ for next_ in following if _leads_to(net, next_, later[0])]
    if leads:
        return leads[0]
    # From another lane of the same edge: the line blends over.
    for beside in net.edges[lane.edge]:
        for name in net.following[beside.name]:
            if _leads_to(net, net.lanes[name], later[0]):
                return net.lanes[name]
    return None


def _leads_to(net: RoadNet, lane: NetLane, edge: str) -> bool:
    while lane.in_junction:
        following = net.following[lane.name]
        if not following:
            return False
        lane = net.lanes[following[0]]
    return lane.edge == edge


def _blended(points: Array, front: Array, recorded: int) -> Array:
    """The line without the points around sideways steps, so that it goes over gradually."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    driven = np.concatenate([np.linalg.norm(np.diff(front, axis=0), axis=1), [0.0]])
    allowed = np.full(len(steps), np.inf)
    allowed[: recorded - 1] = driven[: recorded - 1] + SIDESTEP
    kept = np.ones(len(points), bool)
    length = np.concatenate([[0.0], np.minimum(steps, allowed).cumsum()])
    for jump in np.flatnonzero(steps > allowed):
        kept &= np.abs(length - length[jump]) > BLEND
    kept[[0, -1]] = True
    moved = np.append(True, steps > 1e-3)
    return points[kept & moved]


def _places(line: Array, front: Array) -> Array:
    """Where on the line each point lies, m; never backwards, so a crossing line cannot mislead."""
    place, places = 0, []
    for point in front:
        # Within what a vehicle may drive in a frame, and some.
        near = line[place : place + 40]
        place += int(np.linalg.norm(near - point, axis=1).argmin())
        places.append(place * SPACING)
    return np.array(places)
