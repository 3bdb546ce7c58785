"""What lies and stands beyond the kerb: bays and yards that may be driven on, cars parked off the
road, people in groups, works. SUMO knows nothing of it, and real streets are full of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from anchorflow_driving.geometry import Array, arc_lengths, at_places, box_corners
from anchorflow_driving.log import PEDESTRIAN, STATIC, VEHICLE
from anchorflow_driving.road import DrivableGrid
from anchorflow_driving.simulation.road_net import NetLane, RoadNet

SPARSE, DENSE = 90.0, 18.0  # m of kerb for one thing beyond it, at the least and at the most
END = 10.0  # m of a street before and after its junctions that stay free
STEP, FARTHEST = 0.25, 15.0  # m, of the search for the kerb and how far from a lane's middle
INTO = 0.8  # m that a yard reaches into the road, so that both are one
PLACE, ROW = 2.9, 11.0  # m along the kerb for a parked car, and from one row of them to the next
SPACING, MARGIN = 6.5, 6.0  # m, of parking places and to the ends of their row
CLOSED = 0.1  # share of the free parking places
BARRIER, CONE, POST = (0.5, 2.5), (0.4, 0.4), (0.3, 0.3)  # m; a barrier stands across
POSTS = (15.0, 40.0)  # m from one to the next
ASIDE = 0.3  # of a pavement's width, from its middle


@dataclass(frozen=True, eq=False)
class Roadside:
    """areas: polygons [V, 2] that may be driven on, though no lane leads there"""

    areas: list[Array]
    standing: list[Standing]


@dataclass(frozen=True, eq=False)
class _Kerb:
    """A place at the edge of the road: along it, and out of the road."""

    place: Array  # [2]
    along: Array  # [2]

    @property
    def out(self) -> Array:
        return np.array([self.along[1], -self.along[0]])

    @property
    def heading(self) -> float:
        return float(np.arctan2(self.along[1], self.along[0]))

    def at(self, points: Array) -> Array:
        """[..., 2] m along the kerb and beyond it, in the net's frame."""
        return self.place + points[..., :1] * self.along + points[..., 1:] * self.out


def roadside(net: RoadNet, rng: np.random.Generator, *, level: float) -> Roadside:
    """Things at random along the right kerbs of a net; level: as of `drivable_rings`."""
    road = DrivableGrid(tuple(net.drivable_rings(level=level)))
    spacing = float(np.exp(rng.uniform(np.log(DENSE), np.log(SPARSE))))
    kinds = (_bay, _yard, _people, _works)
    liking = rng.dirichlet(np.ones(len(kinds)))
    found = Roadside([], [])
    for lanes in net.edges.values():
        for kerb in _kerbs(lanes[0], road, rng, spacing=spacing):
            beside = kinds[rng.choice(len(kinds), p=liking)](kerb, rng)
            found.areas.extend(beside.areas)
            for each in beside.standing:
                if not road.holds(box_corners(each.state[:3], np.array(each.size))).any():
                    found.standing.append(each)
    return found


def _kerbs(
    lane: NetLane, road: DrivableGrid, rng: np.random.Generator, *, spacing: float
) -> Iterator[_Kerb]:
    """Places at the road's right edge beside a lane."""
    length = lane.arc_length
    place = END + rng.exponential(spacing)
    while place < length[-1] - END:
        here, next_ = at_places(np.array([place, place + 1.0]), length, lane.centre)
        kerb = _Kerb(here, (next_ - here) / np.linalg.norm(next_ - here))
        aside = np.arange(0.0, FARTHEST, STEP)
        outside = ~road.holds(kerb.at(np.stack([np.zeros_like(aside), aside], -1)))
        if outside.any():
            edge = np.array([0.0, aside[outside.argmax()]])
            yield _Kerb(kerb.at(edge), kerb.along)
        place += rng.exponential(spacing)


def _bay(kerb: _Kerb, rng: np.random.Generator) -> Roadside:
    """The road is wider here."""
    width, depth = float(rng.uniform(6.0, 30.0)), float(rng.uniform(1.0, 3.0))
    return Roadside([_area(kerb, width, depth)], [])


def _yard(kerb: _Kerb, rng: np.random.Generator) -> Roadside:
    """Cars in a row or two across the kerb; most yards may be driven on."""
    cars, rows = int(rng.integers(1, 10)), int(rng.integers(1, 3))
    first = rng.uniform(0.4, 3.0)
    found = Roadside([], [])
    if rng.random() < 0.6:
        width, depth = cars * PLACE + rng.uniform(1.0, 6.0), first + (rows - 1) * ROW + 5.5
        found.areas.append(_area(kerb, width, depth))
    occupied = rng.uniform(0.3, 1.0)
    for row in range(rows):
        for car in range(cars):
            if rng.random() > occupied:
                continue
            size = (float(rng.uniform(3.7, 5.0)), float(rng.uniform(1.65, 1.95)))
            along = (car - (cars - 1) / 2) * PLACE + rng.normal(0.0, 0.1)
            out = first + row * ROW + size[0] / 2 + rng.uniform(0.0, 0.6)
            turn = -np.pi / 2 + np.pi * rng.integers(2) + rng.normal(0.0, 0.06)
            found.standing.append(_stood(kerb, VEHICLE, size, along, out, turn))
    return found


def _people(kerb: _Kerb, rng: np.random.Generator) -> Roadside:
    """A group on foot, near the kerb or well off it."""
    middle = rng.uniform(1.0, 6.0)
    found = Roadside([], [])
    for _ in range(int(rng.integers(1, 9))):
        size = (float(rng.uniform(0.4, 0.8)), float(rng.uniform(0.4, 0.8)))
        along, out = rng.normal(0.0, 2.5), max(middle + rng.normal(0.0, 1.0), 0.5)
        turn = rng.uniform(-np.pi, np.pi)
        found.standing.append(_stood(kerb, PEDESTRIAN, size, along, out, turn))
    return found


def _works(kerb: _Kerb, rng: np.random.Generator) -> Roadside:
    """Barriers or cones in a row along the kerb."""
    size, turn = (BARRIER, np.pi / 2) if rng.random() < 0.5 else (CONE, 0.0)
    spacing, out = rng.uniform(2.6, 4.5), rng.uniform(0.3, 2.0)
    row = [
        _stood(kerb, STATIC, size, number * spacing, out + rng.normal(0.0, 0.1), turn)
        for number in range(int(rng.integers(2, 13)))
    ]
    return Roadside([], row)


def _area(kerb: _Kerb, width: float, depth: float) -> Array:
    corners = [(-1, -INTO), (1, -INTO), (1, depth), (-1, depth)]
    return kerb.at(np.array([(side * width / 2, out) for side, out in corners]))


def _stood(
    kerb: _Kerb, kind: int, size: tuple[float, float], along: float, out: float, turn: float
) -> Standing:
    x, y = kerb.at(np.array([along, out]))
    return Standing(kind, size, np.array([x, y, kerb.heading + turn, 0.0, 0.0]))


@dataclass(frozen=True, eq=False)
class Standing:
    """kind: VEHICLE or STATIC; size: m, length and width; state: [5] as of tracks"""

    kind: int
    size: tuple[float, float]
    state: Array


def all_that_stands(net: RoadNet, rng: np.random.Generator) -> list[Standing]:
    """Parked cars, barriers and cones on closed parking places, posts on the pavements."""
    # A stream of their own: traffic stays as it is without them.
    (aside,) = rng.spawn(1)
    return [*_on_parking_places(net, rng, aside), *_posts(net, aside)]


def _on_parking_places(
    net: RoadNet, rng: np.random.Generator, aside: np.random.Generator
) -> Iterator[Standing]:
    occupied = rng.uniform(0.1, 0.9)
    for band in net.parking:
        middle, _, length = _along(band)
        for place in np.arange(MARGIN, length[-1] - MARGIN, SPACING):
            if rng.random() > occupied:
                if aside.random() < CLOSED:
                    size = BARRIER if aside.random() < 0.5 else CONE
                    yield Standing(STATIC, size, _state(middle, length, place))
                continue
            turn = rng.normal(0.0, 0.03)
            size = (float(rng.uniform(3.7, 5.0)), float(rng.uniform(1.65, 1.95)))
            yield Standing(VEHICLE, size, _state(middle, length, place, turn=turn))


def _posts(net: RoadNet, rng: np.random.Generator) -> Iterator[Standing]:
    for band in net.pavements:
        middle, across, length = _along(band)
        line = middle + ASIDE * rng.choice([-1.0, 1.0]) * across
        place = rng.uniform(0.0, POSTS[1])
        while place < length[-1]:
            yield Standing(STATIC, POST, _state(line, length, place))
            place += rng.uniform(*POSTS)


def _along(band: Array) -> tuple[Array, Array, Array]:
    """The middle line of a band, the way across it at each vertex, and m along it."""
    right, left = band[: len(band) // 2], band[len(band) // 2 :][::-1]
    middle = (right + left) / 2
    return middle, left - right, arc_lengths(middle)


def _state(line: Array, length: Array, place: float, *, turn: float = 0.0) -> Array:
    (x, y), ahead = at_places(np.array([place, place + 1.0]), length, line)
    heading = np.arctan2(ahead[1] - y, ahead[0] - x) + turn
    return np.array([x, y, heading, 0.0, 0.0])
