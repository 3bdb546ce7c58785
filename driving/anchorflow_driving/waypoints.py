"""Plans as waypoints: 45 positions of the rear axle, 0.1 s apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import out_of_frame
from anchorflow_driving.pdm.collisions import boxes_touch
from anchorflow_driving.pdm.traffic import recorded_traffic
from anchorflow_driving.window import Window

Array = NDArray[np.float64]

STANDING = 0.05
"""m between two waypoints, at or below which a vehicle keeps its heading."""


def collides(window: Window, waypoints: Array) -> bool:
    """Whether the ego's box, untracked, overlaps a recorded one at any waypoint [T, 2], T <= 45."""
    poses = np.concatenate([waypoints, waypoint_headings(waypoints)[:, None]], axis=-1)
    traffic = recorded_traffic(window)
    middles = traffic.vehicle.middles(out_of_frame(poses, traffic.start.pose))
    return bool(boxes_touch(middles[None], traffic.vehicle, traffic.others)[0])


def waypoint_headings(waypoints: Array) -> Array:
    """[T] the course from each waypoint's predecessor; the first comes from the origin."""
    step = np.diff(waypoints, axis=0, prepend=np.zeros((1, 2)))
    moves = np.hypot(*step.T) > STANDING
    # The last moving step up to each; index 0 stands for the ego's own heading.
    last = np.maximum.accumulate(np.where(moves, np.arange(1, len(step) + 1), 0))
    return np.concatenate([[0.0], np.arctan2(step[:, 1], step[:, 0])])[last]
