"""The input `others`: the other road users and their pasts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.sensors import OTHERS, OTHERS_TIMES_S, others_before
from anchorflow_driving.geometry import Array
from anchorflow_driving.log import FRAME_S, STATIC
from anchorflow_driving.sensors.bev import BEV
from anchorflow_driving.window import PlannerView

FRAMES_BEFORE = -1 + np.rint(np.array(OTHERS_TIMES_S) / FRAME_S).astype(int)
"""Indices of OTHERS_TIMES_S in a view's tracks, whose last frame is now."""


def tracks_seen(view: PlannerView) -> NDArray[np.int_]:
    """Return the tracks [K] of those that the raster shows now, the nearest OTHERS of them first;
    none is the ego or a static object.
    """
    now = view.tracks[:, -1]
    low_x, high_x, low_y, high_y = BEV.extent
    with np.errstate(invalid="ignore"):  # NaN while absent
        inside = (low_x < now[:, 0]) & (now[:, 0] < high_x)
        inside &= (low_y < now[:, 1]) & (now[:, 1] < high_y)
    inside &= view.track_type != STATIC
    inside[view.ego] = False
    found = np.flatnonzero(inside)
    return found[np.argsort(np.hypot(*now[found, :2].T), kind="stable")][:OTHERS]


def others_seen(view: PlannerView) -> NDArray[np.float32]:
    """Return `others` [48, 5, 8] of a view, as `anchorflow_client.sensors.others_before` says."""
    seen = tracks_seen(view)
    states: Array = view.tracks[seen][:, FRAMES_BEFORE]
    return others_before(states, view.track_size[seen], view.track_type[seen] + 1)
