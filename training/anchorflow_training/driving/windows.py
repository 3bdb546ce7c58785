"""Windows of driving logs as arrays to train on, their rasters kept compressed beside the logs.

A raster of 480 kB compresses to some ten kilobytes and unpacks in a millisecond; drawing takes ten
times as long.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.geometry import arc_lengths, at_places
from anchorflow_driving.log import FRAME_S, FUTURE_FRAMES, open_logs, read_log
from anchorflow_driving.sensors.bev import BEV, DRAWING, draw_bev
from anchorflow_driving.sensors.inputs import status_of
from anchorflow_driving.window import Scenes, Window
from anchorflow_training.driving.log_cache import Arrays, log_arrays, no_windows

Floats = NDArray[np.float32]

KEPT = f".windows-{DRAWING}"
"""Suffix of the file beside a log that holds its windows."""
LEVEL = 3  # of zlib
SPACING = 1.25
"""m between the points of a course."""
COURSE_POINTS = 73  # to 90 m
_RETURN = 15.0  # m over which an offset from the route fades behind the record
MOVED = 0.02  # m; nearer points of a record are one


@dataclass(frozen=True, eq=False)
class DrivingWindows:
    """W windows, those of a log beside one another.

    bev: the zlib streams, one after another; bev_offsets: [W + 1]
    status: [W, 8]; size: [W, 2] of the ego, m
    course: [W, P, 2] places SPACING apart from the rear axle along what was driven and, beyond, the
        route; along: [W, T] how far along it was driven at the poses' times, m
    log: [W] its log, by number
    """

    bev: NDArray[np.uint8]
    bev_offsets: NDArray[np.int64]
    status: Floats
    size: Floats
    course: Floats
    along: Floats
    log: NDArray[np.int64]
    path: Path
    goal: ClassVar[None] = None
    times: ClassVar = PLAN_TIMES
    layout: ClassVar[Mapping[str, Any]] = {
        "channels": len(BEV.channels),
        "rows": BEV.rows,
        "columns": BEV.columns,
        "extent": BEV.extent,
        "dtype": "uint8",
        "drivable": BEV.channels.index("drivable"),
        "boxes": BEV.channels.index("vehicles"),
        "occupied": BEV.channels.index(f"occupied_{BEV.ahead_s[0]:.1f}s"),
        "foretold": len(BEV.ahead_s),
    }
    """Of the rasters, as `BevLayout`."""

    def __len__(self) -> int:
        return len(self.status)

    def rasters(self, windows: Iterable[int]) -> NDArray[np.uint8]:
        """[B, C, H, W] of these windows; may be written to."""
        streams = (self.bev[self.bev_offsets[w] : self.bev_offsets[w + 1]] for w in windows)
        drawn = [np.frombuffer(zlib.decompress(stream.tobytes()), np.uint8) for stream in streams]
        return np.stack(drawn).reshape(-1, *BEV.shape)


PER_WINDOW = ("status", "size", "course", "along")
STORED = ("bev", "bev_sizes", *PER_WINDOW)


def open_windows(folder: Path) -> DrivingWindows:
    """The windows of all logs in a folder; each log's are drawn once and kept beside it.

    Raises `LogError` if there is no log, one or what is kept of it cannot be read, or there is no
    place to write beside it.
    """
    return _joined([*log_arrays(open_logs(folder), KEPT, _drawn)], folder)


def course_of(window: Window) -> tuple[Floats, Floats]:
    """`course` [P, 2] and `along` [T] of a window, in the ego's frame."""
    frames = np.arange(FUTURE_FRAMES + 1)
    driven = window.recorded(np.asarray(frames * FRAME_S, np.float64))[:, :2]
    steps = np.linalg.norm(np.diff(driven, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(np.where(steps > MOVED, steps, 0.0))])
    along = np.interp(PLAN_TIMES, frames * FRAME_S, way)
    kept = np.concatenate([[True], np.diff(way) > 0])
    route = window.view.route
    arc, left = (float(value) for value in route.project(driven[kept][-1]))
    more = np.arange(SPACING, COURSE_POINTS * SPACING, SPACING)
    beyond = route.poses(arc + more, left * np.maximum(0.0, 1 - more / _RETURN))[:, :2]
    line = np.concatenate([driven[kept], beyond])
    course = at_places(SPACING * np.arange(COURSE_POINTS), arc_lengths(line), line)
    return course.astype(np.float32), along.astype(np.float32)


def _of_window(window: Window) -> dict[str, Any]:
    view = window.view
    course, along = course_of(window)
    return {
        "bev": zlib.compress(draw_bev(view).tobytes(), LEVEL),
        "status": status_of(view),
        "size": view.vehicle.size.astype(np.float32),
        "course": course,
        "along": along,
    }


def _drawn(log: Path) -> dict[str, NDArray[Any]]:
    rows = [_of_window(window) for window in Scenes(read_log(log))]
    streams = [row["bev"] for row in rows]
    sizes = np.array([len(stream) for stream in streams], np.int64)
    return {
        "bev": np.frombuffer(b"".join(streams), np.uint8),
        "bev_sizes": sizes,
        **{name: np.array([row[name] for row in rows], np.float32) for name in PER_WINDOW},
    }


def _joined(parts: Sequence[Arrays], folder: Path) -> DrivingWindows:
    parts = [part for part in parts if len(part["bev_sizes"])]
    if not parts:
        raise no_windows(folder)
    whole = {name: np.concatenate([part[name] for part in parts]) for name in STORED}
    sizes = whole.pop("bev_sizes")
    counts = [len(part["bev_sizes"]) for part in parts]
    return DrivingWindows(
        bev_offsets=np.concatenate([[0], sizes.cumsum()]),
        log=np.repeat(np.arange(len(parts)), counts),
        path=folder,
        **whole,
    )
