"""The others as solids: boxes with heights, which logs do not record, in the ego's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.log import CYCLIST, PEDESTRIAN, STATIC, VEHICLE
from anchorflow_driving.window import PlannerView

Array = NDArray[np.float64]

HEIGHT = {VEHICLE: 1.55, PEDESTRIAN: 1.72, CYCLIST: 1.65, STATIC: 0.9}
"""m"""
LONG_VEHICLE, TALL = 6.0, 3.0
"""m; vehicles longer than the first are as high as the second."""


@dataclass(frozen=True)
class Solids:
    """M boxes that stand on the ground."""

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
