"""Motion that a car could drive, from front bumpers that follow polylines.

The box's middle follows the smoothed line of the front bumper; the rear axle is dragged behind it
(a tractrix), so that it never slips and headings are one derivative smoother than the line.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from anchorflow_driving.geometry import Array, Booleans, arc_lengths, at_places
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.route import SPACING, smooth_line
from anchorflow_driving.window import REAR_AXLE

TIME_SIGMA = 0.25
"""s, of the Gaussian over the distance driven."""
BEHIND = 5.0
"""m that a line is known behind the middle of the box at first."""
STANDING = 0.1
"""m/s, below which a speed is noise."""

EVERY = 70
"""Frames between two deviations: what is asked about in one is over before the next begins."""
STRIDE = 10
"""Frames: deviations are asked about at multiples of it, as windows are."""
SIDEWAYS, FAR_SIDEWAYS, FAR_SHARE = 0.7, 3.0, 0.25
"""m: standard deviation, and of a share of deviations the most, evenly."""
ALONG = 1.5
"""m, standard deviation of how far a vehicle gets ahead of itself or falls behind."""
LEAVING_S, RETURNING_S, ALONG_S = 2.0, (2.5, 4.0), 2.5
"""s that a deviation takes to grow and, at least and at most, to fade; and along the line."""
LEAST_SPEED = 2.0
"""m/s, below which no vehicle deviates."""
NORMAL_SIGMA = 3.0
"""m, of the Gaussian over the line that sideways is square to."""


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
    middle = at_places(at, along, line)
    velocity = np.gradient(middle, FRAME_S, axis=0) if len(at) > 1 else 0 * middle
    velocity[np.linalg.norm(velocity, axis=1) < STANDING] = 0.0
    return np.column_stack([middle, np.interp(at, along, heading), velocity])


def person_states(place: Array) -> Array:
    """Return the states [F, 5] of a pedestrian who faces the walking direction."""
    x, y = (_smoothed(axis, 3.0) for axis in place.T)
    velocity = np.gradient(np.stack([x, y], -1), FRAME_S, axis=0) if len(x) > 1 else 0 * place
    speed = np.linalg.norm(velocity, axis=1)
    heading = np.arctan2(velocity[:, 1], velocity[:, 0])
    moving = np.maximum.accumulate(np.where(speed > STANDING, np.arange(len(x)), 0))
    return np.column_stack([x, y, np.unwrap(heading[moving]), velocity])


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


def deviating(front: Array, rng: np.random.Generator, *, first: int) -> tuple[Array, Booleans]:
    """A front bumper [F, 2] that leaves its course now and then, and the frames [F] to ask about.

    A deviation is largest between 1 s after and 0.4 s before its frame, so the vehicle returns or
    is about to. Deviations grow with the distance driven, so a standing vehicle stays.

    first: the frame of front[0]; frames of windows are multiples of STRIDE
    """
    driven = arc_lengths(front)
    asked = np.zeros(len(front), bool)
    frames = np.arange(rng.integers(EVERY), len(front), EVERY)
    frames -= (frames + first) % STRIDE
    frames = frames[(frames > 0) & (frames < len(front) - 1)]
    speed = (driven[frames + 1] - driven[frames - 1]) / (2 * FRAME_S)
    frames, speed = frames[speed > LEAST_SPEED], speed[speed > LEAST_SPEED]
    time = np.arange(len(front)) * FRAME_S
    shift = np.zeros(len(front))
    for frame in frames:
        largest = frame * FRAME_S + rng.uniform(-1.5, 1.5)
        shift += rng.normal(0.0, ALONG) * _bump((time - largest) / ALONG_S)
    at = np.clip(np.maximum.accumulate(driven + shift), 0.0, driven[-1])
    aside = np.zeros(len(front))
    for frame, fast in zip(frames, speed, strict=True):
        far = rng.random() < FAR_SHARE
        size = rng.uniform(-FAR_SIDEWAYS, FAR_SIDEWAYS) if far else rng.normal(0.0, SIDEWAYS)
        away = at - at[frame] - fast * rng.uniform(-1.0, 0.4)
        returning = fast * rng.uniform(*RETURNING_S)
        aside += size * _bump(away / np.where(away < 0, fast * LEAVING_S, returning))
        asked[frame] = True
    if not asked.any():
        return front, asked
    line, normal = _line(front, driven)
    place = at / SPACING
    along = np.arange(len(line))
    across = at_places(place, along, normal)
    return at_places(place, along, line) + aside[:, None] * across, asked


def _line(front: Array, driven: Array) -> tuple[Array, Array]:
    """Return the driven line [V, 2] every SPACING m, and its left normals [V, 2]."""
    at = np.arange(0.0, driven[-1] + SPACING, SPACING)
    line = at_places(at, driven, front)
    smooth = gaussian_filter1d(line, NORMAL_SIGMA / SPACING, axis=0, mode="nearest")
    towards = np.gradient(smooth, axis=0)
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    return line, np.stack([-towards[:, 1], towards[:, 0]], -1)


def _bump(x: Array) -> Array:
    """Return a smooth bump: 0 at -1, 1 at 0, 0 at 1."""
    return np.where(np.abs(x) < 1, (1 + np.cos(np.pi * x)) / 2, 0.0)
