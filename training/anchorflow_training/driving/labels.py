"""Labels and variations of a window that planners with sensors are trained with."""

from __future__ import annotations

from dataclasses import replace
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.sensors import LIDAR_BEFORE_S
from anchorflow_driving.drivers import PLAN_TIMES, constant_velocity, idm
from anchorflow_driving.geometry import states_into_frame
from anchorflow_driving.log import DRIVEN, FRAME_S, STATIC, VEHICLE
from anchorflow_driving.sensors.bev import FULL, LANES, BevGrid, draw_bev, draw_boxes
from anchorflow_driving.window import PlannerView, Window

ASTRAY = 1.5
"""m between where an example is at its first time and where the ego would be at its velocity."""


def example(window: Window) -> NDArray[np.float64] | None:
    """Poses [T, 3] at PLAN_TIMES: those driven or, if a planner under test drove, those of PDM-
    Closed; None if PDM-Closed has no route left and does not continue the ego's motion.
    """
    if window.log.source != DRIVEN:
        return window.recorded(PLAN_TIMES)
    poses = idm(window)
    begun = poses[0] - constant_velocity(window)[0]
    is_near = bool(np.isfinite(poses).all()) and float(np.hypot(*begun[:2])) <= ASTRAY
    return poses if is_near else None


CLASSES = ("nothing", "drivable", "lane", "line", "crosswalk", "static", "vehicle", "person")
# Channels of the raster in the order in which they are painted over one another, and the least
# share of a cell that counts: centrelines touch a cell's edge.
_PAINTED = (
    (("drivable",), FULL // 2),
    (LANES, 1),
    (("lines",), FULL // 4),
    (("crosswalks",), FULL // 2),
    (("static",), FULL // 4),
    (("vehicles",), FULL // 2),
    (("people",), FULL // 4),
)


def semantic_bev(view: PlannerView, *, rows: int, reach: float) -> NDArray[np.uint8]:
    """Indices [rows, 2 rows] into CLASSES from the rear axle to `reach` m ahead and to either side.

    Row 0 lies farthest ahead, column 0 farthest left.
    """
    grid = BevGrid(extent=(0.0, reach, -reach, reach), cell=reach / rows, ahead_s=())
    drawn = dict(zip(grid.channels, draw_bev(view, grid), strict=True))
    classes = np.zeros((rows, 2 * rows), np.uint8)
    for index, (channels, least) in enumerate(_PAINTED, start=1):
        share = np.max([drawn[name] for name in channels], axis=0)
        classes[share >= least] = index
    return classes


def occupancy(window: Window, *, cells: int, reach: float) -> NDArray[np.uint8]:
    """Where others will be: 0 or 1 [T, cells, cells] at the times of a plan, the ego in the middle.

    Row 0 lies farthest ahead, column 0 farthest left, each `reach` m from the rear axle.
    """
    grid = BevGrid(extent=(-reach, reach, -reach, reach), cell=2 * reach / cells, ahead_s=())
    view, others = window.view, np.arange(len(window.view.tracks)) != window.ego
    size = view.track_size[others]
    boxes = [
        draw_boxes(view_after(window, float(time)).tracks[others, -1], size, grid)
        for time in PLAN_TIMES
    ]
    return (np.stack(boxes) >= FULL // 4).astype(np.uint8)


def view_after(window: Window, seconds: float) -> PlannerView:
    """The view, with the others where the record has them later: in the ego's frame now."""
    view, log = window.view, window.log
    frame = window.frame + round(seconds / FRAME_S)
    states = log.track_state[:, frame].astype(np.float64)
    later = states_into_frame(states, view.state.pose)
    return replace(view, tracks=np.repeat(later[:, None], view.tracks.shape[1], axis=1))


KEEP, STOP, REVERSE = 0.3, 0.2, 0.05
"""Shares of others that move as they did, stand, and roll backward."""
FASTEST, FASTEST_ON_FOOT, FASTEST_BACKWARD = 16.0, 6.0, 4.0  # m/s
ACCELERATION = 1.0  # m/s², standard deviation
CURVATURE, CURVED_UP_TO = 0.02, 8.0  # 1/m, standard deviation; m/s up to which cars turn faster


def randomised_motion(view: PlannerView) -> PlannerView:
    """The view with other velocities now, and other places LIDAR_BEFORE_S ago to have come from.

    Current positions stay. Cars move along their heading, the others anywhere; what is
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
