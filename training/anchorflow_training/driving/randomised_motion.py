"""The same scene with others that move as chance has it: where they are tells nothing of how.

Domain randomisation (arXiv 1703.06907): in simulated traffic where a car is says so much of how it
moves that a network learns that, and not to compare two sweeps.
"""

from __future__ import annotations

from dataclasses import replace
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.sensors import LIDAR_BEFORE_S
from anchorflow_driving.log import FRAME_S, STATIC, VEHICLE
from anchorflow_driving.window import PlannerView

KEEP, STOP, REVERSE = 0.3, 0.2, 0.05
"""Shares of others that move as they did, stand, and roll backward."""
FASTEST, FASTEST_ON_FOOT, FASTEST_BACKWARD = 16.0, 6.0, 4.0  # m/s
ACCELERATION = 1.0  # m/s², standard deviation
CURVATURE, CURVED_UP_TO = 0.02, 8.0  # 1/m, standard deviation; m/s up to which cars turn faster


def randomised_motion(view: PlannerView) -> PlannerView:
    """The view with other velocities now, and other places LIDAR_BEFORE_S ago to have come from.

    Everybody is where he is now. Cars move along their heading, the others anywhere; what is
    static stays. The same view always gives the same.
    """
    tracks = view.tracks.copy()
    random = np.random.default_rng(crc32(tracks[:, -1].tobytes()))
    then = tracks.shape[1] - 1 - round(LIDAR_BEFORE_S / FRAME_S)
    moves = np.isfinite(tracks[:, -1]).all(-1) & (view.track_type != STATIC)
    moves[view.ego] = False
    for track in np.flatnonzero(moves):
        is_car = bool(view.track_type[track] == VEHICLE)
        made = _randomised(tracks[track, -1], is_car=is_car, random=random)
        if made is not None:
            tracks[track, then], tracks[track, -1, 3:] = made
    return replace(view, tracks=tracks)


def _randomised(
    now: NDArray[np.float64], *, is_car: bool, random: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """The state [5] of before and the velocity [2] of now; None for as it was."""
    luck, heading = random.random(), float(now[2])
    if luck < KEEP:
        return None
    if not is_car:
        heading = random.uniform(-np.pi, np.pi)
    if luck < KEEP + STOP:
        speed = 0.0
    elif luck > 1 - REVERSE:
        speed = -random.uniform(0, FASTEST_BACKWARD)
    else:
        speed = random.uniform(0, FASTEST if is_car else FASTEST_ON_FOOT)
    turning = random.normal(0, CURVATURE) * min(abs(speed), CURVED_UP_TO)
    gained = random.normal(0, ACCELERATION) * LIDAR_BEFORE_S if speed else 0.0
    way = (speed - gained / 2) * LIDAR_BEFORE_S
    turned = turning * LIDAR_BEFORE_S
    place = now[:2] - way * _along(heading - turned / 2)
    before = np.array([*place, now[2] - turned, *((speed - gained) * _along(heading - turned))])
    return before, speed * _along(heading)


def _along(heading: float) -> NDArray[np.float64]:
    return np.array([np.cos(heading), np.sin(heading)])
