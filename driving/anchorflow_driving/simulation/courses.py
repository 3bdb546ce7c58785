"""Motion that a car could drive, from front bumpers that follow polylines.

The box's middle follows the smoothed line of the front bumper; the rear axle is dragged behind it
(a tractrix), so that it never slips and headings are one derivative smoother than the line.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from anchorflow_driving.log import FRAME_S
from anchorflow_driving.window import REAR_AXLE

Array = NDArray[np.float64]

SPACING = 0.25
"""m between the points of a line."""
LINE_SIGMA = 1.3
"""m, of the Gaussian over a line."""
TIME_SIGMA = 0.25
"""s, of the Gaussian over the distance driven."""
BEHIND = 5.0
"""m that a line is known behind the middle of the box at first."""
STANDING = 0.1
"""m/s, below which a speed is noise."""


def vehicle_states(front: Array, length: float) -> Array:
    """States [F, 5] (x, y, heading, vx, vy) of a box's middle from its front bumper [F, 2]."""
    steps = np.linalg.norm(np.diff(front, axis=0), axis=1)
    steps[steps < 1e-3] = 0.0
    driven = np.concatenate([[0.0], steps.cumsum()])
    before = SPACING * np.ceil((length / 2 + BEHIND) / SPACING)
    line = smooth_line(front[np.append(True, steps > 0)], before=before)
    heading = _dragged(line, REAR_AXLE * length)
    # Where on the line the middle of the box is.
    at = _smoothed(driven, TIME_SIGMA / FRAME_S) + before - length / 2
    along = np.arange(len(line)) * SPACING
    middle = np.stack([np.interp(at, along, axis) for axis in line.T], -1)
    velocity = np.gradient(middle, FRAME_S, axis=0) if len(at) > 1 else 0 * middle
    velocity[np.linalg.norm(velocity, axis=1) < STANDING] = 0.0
    return np.column_stack([middle, np.interp(at, along, heading), velocity])


def person_states(place: Array) -> Array:
    """States [F, 5] of somebody who walks, facing where they go."""
    x, y = (_smoothed(axis, 3.0) for axis in place.T)
    velocity = np.gradient(np.stack([x, y], -1), FRAME_S, axis=0) if len(x) > 1 else 0 * place
    speed = np.linalg.norm(velocity, axis=1)
    heading = np.arctan2(velocity[:, 1], velocity[:, 0])
    moving = np.maximum.accumulate(np.where(speed > STANDING, np.arange(len(x)), 0))
    return np.column_stack([x, y, np.unwrap(heading[moving]), velocity])


def smooth_line(points: Array, *, before: float = 0.0, sigma: float = LINE_SIGMA) -> Array:
    """A polyline every SPACING m, smoothed by a Gaussian; it begins `before` m ahead of its first.

    before: a multiple of SPACING

    Its ends are led on straight, so that they stay where they are.
    """
    if len(points) < 2:
        points = np.concatenate([points, points + np.array([1e-3, 0.0])])
    lead = SPACING * np.ceil((before + 4 * sigma) / SPACING)
    first = points[0] - (points[min(3, len(points) - 1)] - points[0])
    towards = _unit(points[0] - first)
    backwards, onwards = -towards, _unit(points[-1] - points[-2])
    line = np.concatenate(
        [points[:1] + lead * backwards, points, points[-1:] + 4 * sigma * onwards]
    )
    length = np.concatenate([[0.0], np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum()])
    at = np.arange(0.0, length[-1], SPACING)
    even = np.stack([np.interp(at, length, axis) for axis in line.T], -1)
    smoothed = gaussian_filter1d(even, sigma / SPACING, axis=0, mode="nearest")
    return smoothed[round((lead - before) / SPACING) :]


def _smoothed(values: Array, sigma: float) -> Array:
    """Gaussian over time; both ends go on as they were."""
    pad = int(4 * sigma) + 1
    if len(values) < 2:
        return values
    time = np.arange(1, pad + 1)
    head = values[0] - (values[1] - values[0]) * time[::-1]
    tail = values[-1] + (values[-1] - values[-2]) * time
    return gaussian_filter1d(np.concatenate([head, values, tail]), sigma)[pad:-pad]


def _dragged(line: Array, arm: float) -> Array:
    """Heading [V], unwrapped, of an arm whose front end follows the line and whose rear drags."""
    points = (line[:, 0] + 1j * line[:, 1]).tolist()
    towards = points[1] - points[0]
    rear = points[0] - arm * towards / abs(towards)
    arms = []
    for point in points:
        towards = point - rear
        rear = point - arm * towards / abs(towards)
        arms.append(towards)
    # Each arm points to where its front end has moved on to, half a step ahead of its rear.
    heading = np.unwrap(np.angle(np.array(arms)))
    return np.append((heading[:-1] + heading[1:]) / 2, heading[-1])


def _unit(step: Array) -> Array:
    return step / max(float(np.hypot(*step)), 1e-9)
