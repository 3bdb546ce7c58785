"""Cooperative recordings from driving logs: simulated pictures of the car and a roadside camera.

A sequence is one ego of one log. Every frame of the ego has its pose and the others' boxes; the
frames of the log's windows have pictures.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.cooperative.layout import GROUP, CooperativeFrame
from anchorflow_driving.geometry import Array, ahead_of
from anchorflow_driving.log import FRAME_S, STATIC, DrivingLog
from anchorflow_driving.sensors.cameras import camera_images, simulated_roadside
from anchorflow_driving.sensors.rendering import Renderer
from anchorflow_driving.window import Scenes, Vehicle, Window

OTHERS_WITHIN = 80.0
"""m from the ego within which boxes are labelled."""


def log_drives(
    logs: Iterable[DrivingLog], renderer: Renderer
) -> Iterator[tuple[str, list[CooperativeFrame]]]:
    """Drives by name, for `write_recording`."""
    for log in logs:
        windows: dict[int, list[Window]] = {}
        for window in Scenes(log):
            windows.setdefault(window.ego, []).append(window)
        for ego, asked in windows.items():
            yield f"{log.name}{GROUP}{ego}", _drive(log, ego, asked, renderer)


def _drive(
    log: DrivingLog, ego: int, windows: list[Window], renderer: Renderer
) -> list[CooperativeFrame]:
    pictures = {window.frame: _pictures(window, renderer) for window in windows}
    track = log.track_state[ego].astype(np.float64)
    vehicle = Vehicle(*log.track_size[ego].astype(float).tolist())
    there = np.flatnonzero(np.isfinite(track[:, 0]))
    frames = []
    for frame in there.tolist():
        pose = ahead_of(track[frame, :3], -vehicle.rear_axle)
        seen = pictures.get(frame, (None, None))
        boxes = _others(log, ego, frame, pose)
        frames.append(CooperativeFrame(frame * FRAME_S, pose, *seen, boxes))
    return frames


def _pictures(window: Window, renderer: Renderer) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """[3,H,W] of the front camera and of the roadside's."""
    _, front, _ = camera_images(window.view, renderer)
    roadside = simulated_roadside(window.view, renderer)
    return front.transpose(2, 0, 1), roadside.transpose(2, 0, 1)


def _others(log: DrivingLog, ego: int, frame: int, pose: Array) -> Array:
    """[n,5]: vehicles and people near the ego, as a roadside's labels have them."""
    states = log.track_state[:, frame, :3].astype(np.float64)
    near = np.hypot(*(states[:, :2] - pose[:2]).T) < OTHERS_WITHIN  # NaN is not near
    near[ego] = False
    near &= log.track_type != STATIC
    return np.concatenate([states[near], log.track_size[near].astype(np.float64)], 1)
