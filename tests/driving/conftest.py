"""A made-up street: 300 m straight along x, two lanes of 4 m, one vehicle that drives on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from driven_bend import MADE

from anchorflow_driving.log import VEHICLE, DrivingLog, Lane, RoadMap, track_fields, window_fields
from anchorflow_driving.window import Scenes, Window

FRAMES, NOW = 80, 20
LENGTH, WIDTH = 5.0, 2.0


@dataclass(frozen=True)
class Other:
    """Somebody at constant velocity; x and y of the middle at the window's frame."""

    x: float
    y: float
    speed: float = 0.0
    kind: int = VEHICLE
    heading: float = 0.0
    size: tuple[float, float] = (LENGTH, WIDTH)


def straight_track(other: Other) -> np.ndarray:
    t = (np.arange(FRAMES) - NOW) * 0.1
    cos, sin = np.cos(other.heading), np.sin(other.heading)
    columns = [
        other.x + other.speed * t * cos,
        other.y + other.speed * t * sin,
        np.full(FRAMES, other.heading),
        np.full(FRAMES, other.speed * cos),
        np.full(FRAMES, other.speed * sin),
    ]
    return np.stack(columns, -1)


def rectangle(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], np.float64)


def street_fields(ego: Other, others: Sequence[Other] = (), **changed: Any) -> dict[str, Any]:
    everybody = [ego, *others]
    right, between, left = (np.array([[-100.0, y], [200.0, y]]) for y in (0.0, 2.0, 4.0))
    lanes = [
        Lane("right", rectangle(-100, -2, 200, 2), right, successors=(), in_junction=False),
        Lane("left", rectangle(-100, 2, 200, 6), left, successors=(), in_junction=False),
    ]
    road = RoadMap(lanes, [rectangle(-100, -2, 200, 6)], [], [(between, False)])
    states = np.stack([straight_track(each) for each in everybody])
    return {
        "name": "street",
        **MADE,
        **track_fields([e.kind for e in everybody], [e.size for e in everybody], states),
        **road.fields(),
        **window_fields([0], [NOW], [1], [10.0], [right]),
        **changed,
    }


@pytest.fixture(scope="session")
def street() -> Callable[..., DrivingLog]:
    """Makes the log: an ego at `speed` m/s in the right lane, others, fields that differ."""

    def make(*others: Other, speed: float = 10.0, **changed: Any) -> DrivingLog:
        return DrivingLog(**street_fields(Other(0.0, 0.0, speed), others, **changed))

    return make


@pytest.fixture(scope="session")
def on_street(street: Callable[..., DrivingLog]) -> Callable[..., Window]:
    """The only window of the log."""

    def make(*others: Other, **changed: Any) -> Window:
        return Scenes(street(*others, **changed))[0]

    return make


@pytest.fixture(scope="session")
def other() -> type[Other]:
    return Other
