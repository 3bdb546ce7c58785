"""The others as boxes: vehicles nearby, as in NAVSIM, objects far ahead, solids with heights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import Array, wrap_angle
from anchorflow_driving.log import CYCLIST, PEDESTRIAN, STATIC, VEHICLE
from anchorflow_driving.window import PlannerView

Boxes = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]

AGENTS = 30
RANGE_M = 32.0
FAR_OTHERS = 48
FAR_AHEAD_M, FAR_ASIDE_M = (26.0, 78.0), 26.0
"""Between which x, and up to which y, the middles of those lie that are far ahead."""

HEIGHT = {VEHICLE: 1.55, PEDESTRIAN: 1.72, CYCLIST: 1.65, STATIC: 0.9}
"""m"""
LONG_VEHICLE, TALL = 6.0, 3.0
"""m; vehicles longer than the first are as high as the second."""


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
    """Return the nearest of the seen."""
    found = np.flatnonzero(seen)
    away = np.linalg.norm(others.poses[found, :2], axis=1)
    order = found[np.argsort(away, kind="stable")][:most]
    boxes, velocity = np.zeros((most, 5), np.float32), np.zeros((most, 2), np.float32)
    boxes[: len(order), :3] = others.poses[order]
    boxes[: len(order), 2] = wrap_angle(others.poses[order, 2])
    boxes[: len(order), 3:] = others.size[order, :2]
    velocity[: len(order)] = view.tracks[others.track[order], -1, 3:]
    return boxes, velocity, np.arange(most) < len(order)


@dataclass(frozen=True)
class Solids:
    """M boxes on the ground."""

    poses: Array  # [M, 3] of the middles, in the frame of the ego's rear axle
    size: Array  # [M, 3] length, width, height
    kind: NDArray[np.uint8]  # [M]
    track: NDArray[np.int_]  # [M]


def solids(view: PlannerView, *, reach: float, with_ego: bool = False) -> Solids:
    """Who is there now, within `reach` m of the ego's rear axle."""
    now = view.tracks[:, -1]
    near = np.linalg.norm(now[:, :2], axis=1) < reach  # not of NaN
    near[view.ego] = with_ego
    track = np.flatnonzero(near)
    kind, flat = view.track_type[track], view.track_size[track]
    height = np.array([HEIGHT[each] for each in kind.tolist()])
    height[(kind == VEHICLE) & (flat[:, 0] > LONG_VEHICLE)] = TALL
    return Solids(now[track, :3], np.column_stack([flat, height]), kind, track)
