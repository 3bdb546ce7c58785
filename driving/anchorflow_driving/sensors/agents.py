"""Others as lists of boxes, which planners learn to find: the nearest vehicles, as NAVSIM has them,
and whoever stands farther ahead than a LiDAR's square reaches.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import wrap_angle
from anchorflow_driving.log import VEHICLE
from anchorflow_driving.sensors.solids import Solids, solids
from anchorflow_driving.window import PlannerView

Boxes = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]

AGENTS = 30
RANGE_M = 32.0
FAR_OTHERS = 48
FAR_AHEAD_M, FAR_ASIDE_M = (26.0, 78.0), 26.0
"""Between which x, and up to which y, the middles of those lie that are far ahead."""


def nearest_agents(view: PlannerView) -> Boxes:
    """Boxes [30, 5] (x, y, heading, length, width), nearest first, their velocities [30, 2] m/s
    forward and to the left, and which are there [30].

    Vehicles whose middles lie within 32 m of the rear axle in x and in y; zeros where there are
    fewer.
    """
    others = solids(view, reach=2 * RANGE_M)
    near = (np.abs(others.poses[:, :2]) <= RANGE_M).all(1)
    return _boxes(view, others, (others.kind == VEHICLE) & near, most=AGENTS)


def far_others(view: PlannerView) -> Boxes:
    """The same of whatever stands or moves 26 to 78 m ahead and up to 26 m aside, at most 48."""
    least, most = FAR_AHEAD_M
    others = solids(view, reach=most + FAR_ASIDE_M)
    ahead, left = others.poses[:, 0], others.poses[:, 1]
    far = (least <= ahead) & (ahead <= most) & (np.abs(left) <= FAR_ASIDE_M)
    return _boxes(view, others, far, most=FAR_OTHERS)


def _boxes(view: PlannerView, others: Solids, seen: NDArray[np.bool_], *, most: int) -> Boxes:
    """Of those that are seen, the nearest."""
    found = np.flatnonzero(seen)
    away = np.linalg.norm(others.poses[found, :2], axis=1)
    order = found[np.argsort(away, kind="stable")][:most]
    boxes, velocity = np.zeros((most, 5), np.float32), np.zeros((most, 2), np.float32)
    boxes[: len(order), :3] = others.poses[order]
    boxes[: len(order), 2] = wrap_angle(others.poses[order, 2])
    boxes[: len(order), 3:] = others.size[order, :2]
    velocity[: len(order)] = view.tracks[others.track[order], -1, 3:]
    return boxes, velocity, np.arange(most) < len(order)
