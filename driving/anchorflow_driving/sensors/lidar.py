"""A simulated lidar: beams against the others' boxes and the ground.

It spins over the middle of the ego's box.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.sensors import LIDAR_BEFORE_S, lidar_histogram
from anchorflow_driving.geometry import Array, ahead_of, into_frame, states_into_frame
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.sensors.agents import solids
from anchorflow_driving.window import PlannerView

BEAMS = 32
LOWEST, HIGHEST = -25.0, 10.0  # degrees, of the beams' elevations, which lie evenly
AZIMUTHS = 900  # a turn
HEIGHT = 1.85  # m above the ground
REACH = 60.0  # m


def simulated_points(view: PlannerView) -> NDArray[np.float32]:
    """Return the ends [P, 3] m of the beams: x, y, z above the ground, in the rear axle's frame."""
    azimuth = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    slope = np.tan(np.deg2rad(np.linspace(LOWEST, HIGHEST, BEAMS)))
    others = solids(view, reach=REACH + 10.0)
    origin = np.array([view.vehicle.rear_axle, 0.0])
    distance = np.full((BEAMS, AZIMUTHS), np.inf)
    with np.errstate(divide="ignore"):
        ground = np.where(slope < 0, HEIGHT / -slope, np.inf)
    np.minimum(distance, ground[:, None], out=distance)
    for pose, size in zip(others.poses, others.size, strict=True):
        enter, leave, ray = _crossed(pose, size, origin, azimuth)
        if not len(ray):
            continue
        hit = enter[None]
        if size[2] < HEIGHT:  # what passes over its near edge may come down on its top
            falls = np.where(slope < 0, (size[2] - HEIGHT) / np.minimum(slope, -1e-9), 0.0)
            hit = np.maximum(hit, falls[:, None])
        height = HEIGHT + slope[:, None] * hit
        struck = (hit <= leave) & (height >= 0) & (height <= size[2] + 1e-6)
        distance[:, ray] = np.minimum(distance[:, ray], np.where(struck, hit, np.inf))
    beam, ray = np.nonzero(distance < REACH)
    away = distance[beam, ray]
    x, y = origin[0] + away * np.cos(azimuth[ray]), origin[1] + away * np.sin(azimuth[ray])
    return np.stack([x, y, HEIGHT + slope[beam] * away], -1).astype(np.float32)


def simulated_lidar(view: PlannerView) -> NDArray[np.float32]:
    """The histogram [1, 256, 256] of the simulated points."""
    return lidar_histogram(simulated_points(view))


def simulated_lidar_before(view: PlannerView) -> NDArray[np.float32]:
    """The histogram [1, 256, 256] of what was struck LIDAR_BEFORE_S ago, in the frame of now.

    Zeros where the ego was not there yet.
    """
    then = view.tracks.shape[1] - 1 - round(LIDAR_BEFORE_S / FRAME_S)
    axle = ahead_of(view.tracks[view.ego, then, :3], -view.vehicle.rear_axle)
    if not np.isfinite(axle).all():
        return lidar_histogram(np.zeros((0, 3)))
    past = replace(view, tracks=states_into_frame(view.tracks[:, : then + 1], axle))
    return lidar_histogram(simulated_points(past), pose=axle)


def _crossed(
    pose: Array, size: Array, origin: Array, azimuth: Array
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Where rays enter and leave a box in the plane, m, and which rays do (the slab method)."""
    start = into_frame(origin, pose)
    turned = azimuth - pose[2]
    direction = np.stack([np.cos(turned), np.sin(turned)], -1)
    direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
    near = (-size[:2] / 2 - start) / direction
    far = (size[:2] / 2 - start) / direction
    enter = np.minimum(near, far).max(1)
    leave = np.maximum(near, far).min(1)
    ray = np.flatnonzero((enter < leave) & (enter > 0))
    return enter[ray], leave[ray], ray
