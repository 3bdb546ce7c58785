"""The nearest vehicles as a list of boxes, which NAVSIM's planners learn to find."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import wrap_angle
from anchorflow_driving.log import VEHICLE
from anchorflow_driving.sensors.solids import solids
from anchorflow_driving.window import PlannerView

AGENTS = 30
RANGE_M = 32.0


def nearest_agents(
    view: PlannerView,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Boxes [30, 5] (x, y, heading, length, width), nearest first, their velocities [30, 2] m/s
    forward and to the left, and which are there [30].

    Vehicles whose middles lie within 32 m of the rear axle in x and in y; zeros where there are
    fewer.
    """
    others = solids(view, reach=2 * RANGE_M)
    seen = np.flatnonzero(
        (others.kind == VEHICLE) & (np.abs(others.poses[:, :2]) <= RANGE_M).all(1)
    )
    order = seen[np.argsort(np.linalg.norm(others.poses[seen, :2], axis=1), kind="stable")][:AGENTS]
    boxes = np.zeros((AGENTS, 5), np.float32)
    boxes[: len(order), :3] = others.poses[order]
    boxes[: len(order), 2] = wrap_angle(others.poses[order, 2])
    boxes[: len(order), 3:] = others.size[order, :2]
    velocity = np.zeros((AGENTS, 2), np.float32)
    velocity[: len(order)] = view.tracks[others.track[order], -1, 3:]
    return boxes, velocity, np.arange(AGENTS) < len(order)
