"""Drivers who left their line and go back to it: where a planner that erred finds itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from anchorflow_driving.lines import SPACING
from anchorflow_driving.log import FRAME_S

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]

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
"""m/s, below which nobody deviates."""
NORMAL_SIGMA = 3.0
"""m, of the Gaussian over the line that sideways is square to."""


def deviating(front: Array, rng: np.random.Generator, *, first: int) -> tuple[Array, Booleans]:
    """A front bumper [F, 2] that leaves its course now and then, and the frames [F] to ask about.

    A deviation is largest between 1 s after and 0.4 s before its frame, so the vehicle returns, or
    is about to. Who stands stays where it is: sideways goes with the distance driven.

    first: the frame of front[0], of which those asked about are multiples of STRIDE
    """
    moved = np.linalg.norm(np.diff(front, axis=0), axis=1)
    driven = np.concatenate([[0.0], moved.cumsum()])
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
    points = [np.interp(place, along, axis) for axis in line.T]
    across = [np.interp(place, along, axis) for axis in normal.T]
    return np.stack(points, -1) + aside[:, None] * np.stack(across, -1), asked


def _line(front: Array, driven: Array) -> tuple[Array, Array]:
    """What was driven, [V, 2] every SPACING m, and to the left of it [V, 2]."""
    at = np.arange(0.0, driven[-1] + SPACING, SPACING)
    line = np.stack([np.interp(at, driven, axis) for axis in front.T], -1)
    smooth = gaussian_filter1d(line, NORMAL_SIGMA / SPACING, axis=0, mode="nearest")
    towards = np.gradient(smooth, axis=0)
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    return line, np.stack([-towards[:, 1], towards[:, 0]], -1)


def _bump(x: Array) -> Array:
    """From 0 at -1 to 1 at 0 and back to 0 at 1, smoothly."""
    return np.where(np.abs(x) < 1, (1 + np.cos(np.pi * x)) / 2, 0.0)
