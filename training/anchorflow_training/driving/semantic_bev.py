"""What is where before the ego, as one class a cell: now, and when the plan ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.geometry import states_into_frame
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.sensors.bev import FULL, LANES, BevGrid, draw_bev, draw_boxes
from anchorflow_driving.window import PlannerView, Window

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
