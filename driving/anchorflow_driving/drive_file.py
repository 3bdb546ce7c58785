"""A drive as a file that the page plays: the inputs of a planner along one vehicle's path.

JSON. Metres, radians, seconds; `map` and `pose` in the frame that the ego's rear axle has first,
`recorded` and `boxes` in the one that it has then.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import TensorSpec
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.errors import SensorError
from anchorflow_driving.geometry import Array, into_frame
from anchorflow_driving.log import FRAME_S, FUTURE_FRAMES, HISTORY_FRAMES, DrivingLog, window_fields
from anchorflow_driving.route import Route
from anchorflow_driving.sensors.inputs import check_inputs, draw_inputs
from anchorflow_driving.window import Scenes, Window
from anchorflow_driving.window_choice import command

FORMAT = "anchorflow-drive"
VERSION = 1
SIGHT = 100.0
"""m around the ego that are drawn."""
FAMILIES = ("drivable", "crosswalk", "line", "centre")
_FEW = 64  # numbers that are written out, not packed


def windows_on_the_way(
    log: DrivingLog, *, track: int | None = None, every_s: float = 0.5
) -> DrivingLog:
    """Return the log with windows about one vehicle alone, along its whole record.

    Route and speed limit are those of the vehicle's nearest window; the command follows from the
    route, as in simulated logs.

    track: one with a window; by default the one that drives farthest
    every_s: s from one window to the next, in whole frames

    Raises `SensorError` if the log has no window about the track, or time is no number of frames.
    """
    known = np.unique(log.window_ego).tolist()
    stride = round(every_s / FRAME_S)
    if stride < 1 or not np.isclose(stride * FRAME_S, every_s):
        raise SensorError(f"every: expected a multiple of {FRAME_S} s, got {every_s:g} s")
    if not known:
        raise SensorError(f"{log.path}: expected a log with windows, got none")
    ego = max(known, key=lambda each: _driven(log, each)) if track is None else track
    if ego not in known:
        there = ", ".join(map(str, known))
        raise SensorError(f"{log.path}: track: expected one of {there}, got {ego}")
    frames = _whole_frames(log, ego, stride)
    own = np.flatnonzero(log.window_ego == ego)
    nearest = [own[np.abs(log.window_frame[own] - frame).argmin()] for frame in frames]
    routes = [log.route(int(index)) for index in nearest]
    commands = [
        _command(log, ego, frame, route) for frame, route in zip(frames, routes, strict=True)
    ]
    limits = log.window_speed_limit[nearest]
    return replace(log, **window_fields([ego] * len(frames), frames, commands, limits, routes))


def drive_file(
    log: DrivingLog, specs: Sequence[TensorSpec], *, of: str
) -> tuple[dict[str, Any], Iterator[dict[str, Any]]]:
    """Return a drive without its `frames`, and an iterator over them, of a log on one vehicle.

    specs: inputs of bundle `of`

    Raises `SensorError` if no log has one of the inputs.
    """
    check_inputs(specs, of=of)
    windows = list(Scenes(log))
    origin = windows[0].view.state.pose
    vehicle = windows[0].vehicle
    about = {
        "format": FORMAT,
        "version": VERSION,
        "log": log.name,
        "source": log.source,
        "licence": log.licence,
        "track": windows[0].ego,
        "bundle": of,
        "inputs": [
            {"name": spec.name, "dtype": spec.dtype, "shape": list(spec.shape[1:])}
            for spec in specs
        ],
        "ego": rounded(np.array([vehicle.rear_axle, 0.0, 0.0, *vehicle.size])),
        "times_s": PLAN_TIMES.tolist(),
        "map": _map(log, windows, origin),
    }
    return about, (_frame(window, specs, origin) for window in windows)


def _driven(log: DrivingLog, track: int) -> float:
    places = log.track_state[track, :, :2]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return float(np.nansum(steps))


def _whole_frames(log: DrivingLog, ego: int, stride: int) -> NDArray[np.int_]:
    """Frames with enough record before and after them, the first of the ego's windows among them.

    They do not leap over a gap in the record.
    """
    known = np.isfinite(log.track_state[ego]).all(-1)
    start = int(log.window_frame[log.window_ego == ego].min())
    gaps = np.flatnonzero(~known)
    first = int(gaps[gaps < start].max(initial=-1)) + 1 + HISTORY_FRAMES
    last = int(gaps[gaps > start].min(initial=log.frames)) - 1 - FUTURE_FRAMES
    return np.arange(start - (start - first) // stride * stride, last + 1, stride)


def _command(log: DrivingLog, ego: int, frame: int, route: Array) -> int:
    places = log.track_state[ego, [frame, frame + FUTURE_FRAMES], :2].astype(np.float64)
    now, end = Route(route).project(places)[0]
    return command(route, float(now), float(end))


def _map(log: DrivingLog, windows: Sequence[Window], origin: Array) -> dict[str, Any]:
    """Return the lines within SIGHT of the ego anywhere, each x0, y0, x1, y1, …"""
    way = np.stack([window.view.state.pose[:2] for window in windows])
    low, high = way.min(0) - SIGHT, way.max(0) + SIGHT
    return {
        name: [
            rounded(into_frame(line, origin).ravel())
            for line in log.polylines(name)
            if (line.max(0) >= low).all() and (line.min(0) <= high).all()
        ]
        for name in FAMILIES
    }


def _frame(window: Window, specs: Sequence[TensorSpec], origin: Array) -> dict[str, Any]:
    view = window.view
    arrays = draw_inputs(view, specs)
    return {
        "time_s": round(window.frame * FRAME_S, 3),
        "pose": rounded(into_frame(view.state.pose, origin), digits=4),
        "command": window.command_name,
        "recorded": rounded(window.recorded(PLAN_TIMES), digits=3),
        "boxes": _boxes(window),
        "inputs": {spec.name: packed(arrays[spec.name], spec) for spec in specs},
    }


def _boxes(window: Window) -> list[list[float]]:
    """x, y, heading, length, width and type of the others in sight."""
    view = window.view
    poses = view.tracks[:, -1, :3]
    seen = np.linalg.norm(poses[:, :2], axis=1) <= SIGHT  # NaN is not
    seen[view.ego] = False
    boxes = np.concatenate([poses, view.track_size, view.track_type[:, None].astype(float)], -1)
    return rounded(boxes[seen])


def packed(array: NDArray[Any], spec: TensorSpec) -> Any:
    """A few numbers as they are, more as their little-endian bytes, deflated."""
    values = np.ascontiguousarray(array, np.dtype(spec.dtype).newbyteorder("<"))
    if values.ndim <= 1 and values.size <= _FEW:
        # The shortest decimals that mean the same number of this precision.
        shortest = [float(str(value)) for value in values.ravel()]
        return shortest if values.ndim else shortest[0]
    return {
        "dtype": spec.dtype,
        "shape": list(values.shape),
        "zlib": base64.b64encode(zlib.compress(values.tobytes(), 9)).decode(),
    }


def rounded(values: Array, *, digits: int = 2) -> Any:
    """Return nested lists of numbers with so many decimals."""
    return np.round(values.astype(np.float64), digits).tolist()
