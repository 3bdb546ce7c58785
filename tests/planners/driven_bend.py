"""Logs of a made-up bend: one lane along an arc, an ego that drives it, a leader before it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from anchorflow_driving.log import DrivingLog, write_log

FRAMES, STRIDE = 90, 10
SPEED, GAP = 8.0, 20.0
SIZE = (4.6, 1.9)
CURVATURES = (0.02, -0.012)


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
        source="made",
        licence="none",
        city="nowhere",
        dt=0.1,
        track_type=np.zeros(2, np.uint8),
        track_size=np.full((2, 2), SIZE, np.float32),
        track_state=states.astype(np.float32),
        **_family("lane", ring),
        lane_intersection=np.zeros(1, bool),
        lane_edges=np.zeros((0, 2), np.int32),
        **_family("centre", centre),
        **_family("drivable", ring),
        **_family("crosswalk"),
        **_family("line"),
        line_solid=np.zeros(0, bool),
        window_ego=np.zeros(count, np.int32),
        window_frame=frames.astype(np.int32),
        window_command=np.ones(count, np.uint8),
        window_speed_limit=np.full(count, 10.0, np.float32),
        **_family("route", *[centre] * count),
    )


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


def _family(name: str, *lines: np.ndarray) -> dict[str, np.ndarray]:
    offsets = np.cumsum([0, *map(len, lines)], dtype=np.int32)
    points = np.concatenate([*lines, np.zeros((0, 2))]).astype(np.float32)
    return {f"{name}_points": points, f"{name}_offsets": offsets}
