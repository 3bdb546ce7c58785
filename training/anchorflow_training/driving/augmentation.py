"""Driving to train on, made more: mirrored, set beside the course, faster or slower, re-timed.

A raster is moved with the ego; a start that was disturbed rejoins the course.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.sensors.bev import BEV, LANES
from anchorflow_training.driving.feature_windows import FeatureWindows
from anchorflow_training.driving.windows import SPACING, DrivingWindows
from anchorflow_training.settings import setting

Floats = NDArray[np.float64]

VELOCITY, ACCELERATION = slice(4, 6), slice(6, 8)
LEFT_FOR_RIGHT = [2, 1, 0, 3, 4, 5, 6, 7]
TO_THE_SIDE = np.array([1, 1, 1, 1, 1, -1, 1, -1], np.float32)
REJOIN_S, REJOIN_LEAST = 2.5, 6.0  # s of driving, and m, in which a start is made good
FASTEST = 18.0  # m/s of what is re-timed


@dataclass(frozen=True)
class AugmentationConfig:
    """How far a start is moved: normal, with these spreads."""

    mirror: float = setting(0.5, "Share of windows that are reflected.", ge=0, le=1)
    moved: float = setting(0.5, "Share of windows whose start is moved and turned.", ge=0, le=1)
    shift: float = setting(0.35, "m to the side.", ge=0)
    rotation: float = setting(0.04, "rad.", ge=0)
    speed: float = setting(0.06, "Of the speed.", ge=0)
    braking: float = setting(3.5, "m/s², the most in what is re-timed.", ge=0)
    pulling: float = setting(2.2, "m/s², the most in what is re-timed.", ge=0)


@dataclass(frozen=True, eq=False)
class DrawnWindows:
    """B windows as they are learnt from.

    bev: [B, C, H, W], not yet moved; moved: [B, 3] x, y, heading of the start in the frame of
        what was drawn; mirrored: [B] whether left is right
    status: [B, 8]; size: [B, 2]; course: [B, P, 2], from the start as it was moved
    targets: [B, N, T, 3] poses; the first N / 2 as it was driven, the others re-timed
    """

    bev: NDArray[Any]
    moved: NDArray[np.float32]
    mirrored: NDArray[np.bool_]
    status: NDArray[np.float32]
    size: NDArray[np.float32]
    course: NDArray[np.float32]
    targets: NDArray[np.float32]


def draw(
    windows: DrivingWindows | FeatureWindows,
    chosen: NDArray[np.int64],
    config: AugmentationConfig,
    *,
    samples: int,
    rng: np.random.Generator,
) -> DrawnWindows:
    """The chosen windows, disturbed, each with `samples` targets."""
    bev = windows.rasters(chosen)
    status, course = (getattr(windows, name)[chosen].astype(float) for name in ("status", "course"))
    along = windows.along[chosen].astype(float)
    mirrored = rng.random(len(chosen)) < config.mirror
    for i in np.flatnonzero(mirrored):
        mirror(bev[i], status[i], course[i])
    speed, faster = status[:, 4], 1 + config.speed * rng.standard_normal(len(chosen))
    along = rejoined(along, speed * (faster - 1), windows.times)
    status[:, VELOCITY] *= faster[:, None]
    spreads = np.array([0.0, config.shift, config.rotation])
    moved = spreads * rng.standard_normal((len(chosen), 3))
    moved[rng.random(len(chosen)) >= config.moved] = 0.0
    # Who stands stays where he is: he could not rejoin.
    moved[speed < 1.0] = 0.0
    course = np.stack([disturbed(*each) for each in zip(course, moved, status[:, 4], strict=True)])
    half = samples // 2
    timed = np.concatenate(
        [
            np.repeat(along[:, None], samples - half, axis=1),
            retimed(status[:, 4], config, windows.times, count=half, rng=rng),
        ],
        axis=1,
    )
    targets = np.stack([poses_on(line, s) for line, s in zip(course, timed, strict=True)])
    return DrawnWindows(
        bev=bev,
        moved=moved.astype(np.float32),
        mirrored=mirrored,
        status=status.astype(np.float32),
        size=windows.size[chosen],
        course=course.astype(np.float32),
        targets=targets.astype(np.float32),
    )


def mirror(bev: NDArray[np.uint8], status: Floats, course: Floats) -> None:
    """Left for right, in place: raster [C, H, W], status [8], course [P, 2]."""
    bev[:] = bev[:, :, ::-1]
    left, right = (BEV.channels.index(LANES[k]) for k in (1, 3))
    bev[[left, right]] = bev[[right, left]]
    status[:] = mirrored_status(status)
    course[:, 1] *= -1


def mirrored_status(status: NDArray[Any]) -> NDArray[Any]:
    """Ego status [..., 8] with left for right: the command, and what points to the side."""
    return status[..., LEFT_FOR_RIGHT] * TO_THE_SIDE


def rejoined(along: Floats, faster: Floats, times: Floats) -> Floats:
    """Ways [B, T] at times [T] of cars that start faster [B] (m/s) and are where they were at the
    end."""
    fading = times * (1 - times / times[-1]) ** 2
    return np.maximum.accumulate(np.maximum(along + faster[:, None] * fading, 0.0), axis=1)


def retimed(
    speed: Floats,
    config: AugmentationConfig,
    times: Floats,
    *,
    count: int,
    rng: np.random.Generator,
) -> Floats:
    """Ways [B, N, T] at times [T] and constant accelerations, from speeds [B] on."""
    acceleration = rng.uniform(-config.braking, config.pulling, (len(speed), count, 1))
    start, most = speed[:, None, None], np.maximum(speed, FASTEST)[:, None, None]
    bound = np.where(acceleration < 0, -start, most - start)
    until = np.minimum(times, bound / np.where(acceleration == 0, 1e-9, acceleration))
    return start * times + acceleration * until * (times - 0.5 * until)


def disturbed(course: Floats, moved: Floats, speed: float) -> Floats:
    """A course [P, 2] from a start at `moved` (x, y, heading), in the frame of that start."""
    _, aside, turn = moved
    places = SPACING * np.arange(len(course))
    reach = max(REJOIN_S * speed, REJOIN_LEAST)
    share = np.clip(places / reach, 0.0, 1.0)
    # Cubic Hermite, from the start's offset and direction to none.
    offset = aside * (1 + 2 * share) * (1 - share) ** 2
    offset += np.tan(turn) * reach * share * (1 - share) ** 2
    slope = np.gradient(course, axis=0)
    normal = np.stack([-slope[:, 1], slope[:, 0]], -1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
    x, y = (course + offset[:, None] * normal - [0.0, aside]).T
    cos, sin = np.cos(turn), np.sin(turn)
    return np.stack([cos * x + sin * y, cos * y - sin * x], -1)


def poses_on(course: Floats, along: Floats) -> Floats:
    """Poses [..., 3] at ways [...] along a course [P, 2]."""
    places = SPACING * np.arange(len(course))
    slope = np.gradient(course, axis=0)
    heading = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
    return np.stack([np.interp(along, places, axis) for axis in (*course.T, heading)], -1)
