"""What stands beside the lanes all the time; SUMO knows nothing of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.log import STATIC, VEHICLE
from anchorflow_driving.simulation.road_net import RoadNet

Array = NDArray[np.float64]

SPACING, MARGIN = 6.5, 6.0  # m, of parking places and to the ends of their row
CLOSED = 0.1  # share of the free parking places
BARRIER, CONE, POST = (0.5, 2.5), (0.4, 0.4), (0.3, 0.3)  # m; a barrier stands across
POSTS = (15.0, 40.0)  # m from one to the next
ASIDE = 0.3  # of a pavement's width, from its middle


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
    steps = np.linalg.norm(np.diff(middle, axis=0), axis=1)
    return middle, left - right, np.concatenate([[0.0], steps.cumsum()])


def _state(line: Array, length: Array, place: float, *, turn: float = 0.0) -> Array:
    x, y = (np.interp(place, length, axis) for axis in line.T)
    ahead = [np.interp(place + 1.0, length, axis) for axis in line.T]
    heading = np.arctan2(ahead[1] - y, ahead[0] - x) + turn
    return np.array([x, y, heading, 0.0, 0.0])
