"""The centreline that a simulated driver followed, extended past the record."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from anchorflow_driving.geometry import Array
from anchorflow_driving.route import ROUTE_SIGMA, blended, places_on, smooth_line
from anchorflow_driving.simulation.road_net import NetLane, RoadNet
from anchorflow_driving.simulation.sumo_traffic import VehicleRecord

CHANGING_SPACING = 2.0
"""m between points where a line changes lanes."""
BEYOND = 60.0
"""m by which a route extends past the record."""


def followed_line(net: RoadNet, vehicle: VehicleRecord) -> tuple[Array, Array]:
    """The smoothed centreline [V, 2], and where on it [F] the front bumper was, m."""
    front = np.asarray(vehicle.front)
    points, begin = [], 0
    for name, noted in groupby(vehicle.lane, key=lambda each: each[0]):
        along, lane = np.array([position for _, position in noted]), net.lanes.get(name)
        end = begin + len(along)
        points.append(lane.points(along) if lane else front[begin:end])
        begin = end
    last = net.lanes.get(vehicle.lane[-1][0])
    if last:
        edges, place = vehicle.route[vehicle.on_route :], vehicle.lane[-1][1]
        points.append(line_ahead(net, last, place, edges, length=BEYOND))
    line = blended(np.concatenate(points), front)
    smoothed = smooth_line(line, sigma=ROUTE_SIGMA)
    return smoothed, places_on(smoothed, front)


def line_ahead(
    net: RoadNet, lane: NetLane, position: float, edges: Sequence[str], *, length: float
) -> Array:
    """Points [V, 2] from a position on a lane along edges, for `length` m or as far as they go.

    edges: the lane's own, or the one before its junction, is the first. Where another lane of an
    edge leads on, the line changes over in the middle of the edge.
    """
    parts, left = [], list(edges)
    start, done = position / lane.sumo_length, 0.0
    while done < length:
        if lane.in_junction:
            leaves, leading = lane, net.following[lane.name]
        else:
            while left and left[0] != lane.edge:
                left.pop(0)
            leaves, leading = _exit(net, lane, left[1]) if len(left) > 1 else (lane, [])
        parts.append(_changing(lane, leaves, start))
        done += (1 - start) * lane.arc_length[-1]
        if not leading:
            break
        lane, start = net.lanes[leading[0]], 0.0
    return np.concatenate(parts)


def _exit(net: RoadNet, lane: NetLane, edge: str) -> tuple[NetLane, list[str]]:
    """The nearest lane of the same edge that leads to another, and what follows it there."""
    for leaves in sorted(net.edges[lane.edge], key=lambda beside: abs(beside.index - lane.index)):
        leading = [
            name for name in net.following[leaves.name] if _leads_to(net, net.lanes[name], edge)
        ]
        if leading:
            return leaves, leading
    return lane, []


def _changing(lane: NetLane, leaves: NetLane, start: float) -> Array:
    """Return a line that changes from a lane to another beside it, from `start` on."""
    count = max(2, round((1 - start) * lane.arc_length[-1] / CHANGING_SPACING) + 1)
    share = np.linspace(start, 1.0, count)
    if leaves is lane:
        # The lane's own points, so that its curves stay as they are.
        inner = lane.arc_length / lane.arc_length[-1]
        share = np.concatenate([[start], inner[inner > start]])
    over = np.clip(((share - start) / max(1 - start, 1e-9) - 0.3) / 0.4, 0.0, 1.0)[:, None]
    over = over**2 * (3 - 2 * over)
    here, there = (each.points(share * each.sumo_length) for each in (lane, leaves))
    return (1 - over) * here + over * there


def _leads_to(net: RoadNet, lane: NetLane, edge: str) -> bool:
    while lane.in_junction:
        following = net.following[lane.name]
        if not following:
            return False
        lane = net.lanes[following[0]]
    return lane.edge == edge
