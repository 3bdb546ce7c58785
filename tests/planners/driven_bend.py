"""Logs of a made-up bend: one lane along an arc, an ego that drives it, a leader before it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from anchorflow_driving.log import (
    VEHICLE,
    DrivingLog,
    Lane,
    RoadMap,
    track_fields,
    window_fields,
    write_log,
)

FRAMES, STRIDE = 90, 10
SPEED, GAP = 8.0, 20.0
SIZE = (4.6, 1.9)
CURVATURES = (0.02, -0.012)
MADE: dict[str, Any] = {"source": "made", "licence": "none", "city": "nowhere", "dt": 0.1}


def bend(number: int, *, mirrored: bool = False) -> DrivingLog:
    """A log whose lane bends by the number's curvature, 1/m."""
    curvature = CURVATURES[number % len(CURVATURES)] * (-1 if mirrored else 1)
    way = SPEED * 0.1 * np.arange(FRAMES)
    states = np.stack([_states(curvature, way), _states(curvature, way + GAP)])
    along = np.arange(-40.0, 220.0, 2.0)
    centre, left, right = (_arc(curvature, along, aside)[:, :2] for aside in (0.0, 3.0, -3.0))
    ring = np.concatenate([left, right[::-1]])
    frames = np.arange(20, FRAMES - 45, STRIDE)
    count = len(frames)
    return DrivingLog(
        name=f"bend-{number}",
        **MADE,
        **track_fields([VEHICLE] * 2, [SIZE] * 2, states),
        **one_lane(ring, centre),
        **window_fields([0] * count, frames, [1] * count, [10.0] * count, [centre] * count),
    )


def one_lane(polygon: np.ndarray, centre: np.ndarray) -> dict[str, Any]:
    """A log's fields of a map with a lane that is all that may be driven on."""
    lane = Lane("lane", polygon, centre, successors=(), in_junction=False)
    return RoadMap([lane], [polygon], [], []).fields()


def write_bends(folder: Path, *, count: int) -> Path:
    """So many of them, in a folder that is there."""
    for number in range(count):
        write_log(bend(number), folder / f"bend-{number}.npz")
    return folder


def _arc(curvature: float, along: np.ndarray, aside: float = 0.0) -> np.ndarray:
    heading = curvature * along
    x, y = np.sin(heading) / curvature, (1 - np.cos(heading)) / curvature
    return np.stack([x - aside * np.sin(heading), y + aside * np.cos(heading), heading], -1)


def _states(curvature: float, way: np.ndarray) -> np.ndarray:
    poses = _arc(curvature, way)
    velocity = SPEED * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], -1)
    return np.concatenate([poses, velocity], -1)
