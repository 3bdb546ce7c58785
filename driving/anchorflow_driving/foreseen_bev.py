"""Draw the raster with the others at their predicted places instead of at constant velocity.

inputs["bev"] = foreseen_bev(view, asked_futures(client, inputs))
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.futures import Futures
from anchorflow_driving.geometry import Array, into_frame
from anchorflow_driving.sensors.bev import BEV, FULL, BevGrid, Bytes, draw_bev, draw_boxes, later
from anchorflow_driving.sensors.others import tracks_seen
from anchorflow_driving.window import PlannerView

LONG_M = 7.0
"""Boxes up to this length are drawn in small windows of cells."""


def foreseen_bev(view: PlannerView, futures: Futures, grid: BevGrid = BEV) -> Bytes:
    """Return the raster [C, H, W] of `draw_bev` whose channels occupied_T hold the share of a cell
    that is covered in each mode, by its probability.

    futures: of `others_seen`; beyond their last pose the others keep its velocity. Static objects
    are drawn as ever.
    """
    seen = tracks_seen(view)
    drawn = draw_bev(view, grid)
    first = grid.channels.index(f"occupied_{grid.ahead_s[0]:.1f}s")
    rest = _not_predicted(view, seen, grid)
    poses = _continued(futures.poses[: len(seen)], grid)
    weights = np.repeat(futures.probabilities[: len(seen), :, None], len(grid.ahead_s), 2)
    sizes = view.track_size[seen][:, None, None].repeat(poses.shape[1], 1).repeat(poses.shape[2], 2)
    layers = np.tile(np.arange(len(grid.ahead_s)), (*poses.shape[:2], 1))
    covered = _covered(poses, sizes, weights, layers, grid)
    drawn[first:] = np.rint(np.minimum(np.maximum(rest, FULL * covered), FULL)).astype(np.uint8)
    return drawn


def _not_predicted(view: PlannerView, seen: NDArray[np.int_], grid: BevGrid) -> Bytes:
    """Return the channels [L, H, W] of all that are not predicted, at constant velocity."""
    now = np.array(view.tracks[:, -1])
    now[[view.ego, *seen]] = np.nan
    return np.stack([draw_boxes(later(now, s), view.track_size, grid) for s in grid.ahead_s])


def _continued(poses: Array, grid: BevGrid) -> Array:
    """Return poses [A, M, T', 3] at the times of a raster."""
    places = np.interp(grid.ahead_s, PLAN_TIMES, np.arange(len(PLAN_TIMES)))
    taken = poses[:, :, np.rint(places).astype(int)].astype(np.float64)
    over = np.maximum(np.asarray(grid.ahead_s) - PLAN_TIMES[-1], 0.0)[:, None]
    velocity = (poses[:, :, -1:, :2] - poses[:, :, -2:-1, :2]) / (PLAN_TIMES[-1] - PLAN_TIMES[-2])
    taken[..., :2] += over * velocity
    return taken


def _covered(
    poses: Array, sizes: Array, weights: Array, layers: NDArray[np.int_], grid: BevGrid
) -> Array:
    """Return the weighted shares [L, H, W] of cells that boxes cover, each in its layer."""
    shape = (len(grid.ahead_s), grid.rows, grid.columns)
    total = np.zeros(int(np.prod(shape)))
    poses, sizes = poses.reshape(-1, 3), sizes.reshape(-1, 2)
    weights, layers = weights.ravel(), layers.ravel()
    long = sizes[:, 0] > LONG_M
    for chosen in (~long, long):
        if not chosen.any():
            continue
        reach = int(np.ceil(np.hypot(*sizes[chosen].T).max() / 2 / grid.cell)) + 1
        cells = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2, indexing="ij"), -1)
        # Row 0 lies at the greatest x, column 0 at the greatest y.
        high = np.array([grid.extent[1], grid.extent[3]])
        middle = np.floor((high - poses[chosen, :2]) / grid.cell).astype(int)
        cell = middle[:, None, None] + cells
        places: Array = (high - (cell + 0.5) * grid.cell).astype(np.float64)
        local = into_frame(places, poses[chosen, None, None])
        inside = (sizes[chosen, None, None] / 2 - np.abs(local)) / grid.cell + 0.5
        share = inside.clip(0.0, 1.0).prod(-1) * weights[chosen, None, None]
        within = ((cell >= 0) & (cell < shape[1:])).all(-1) & (share > 0)
        place = (layers[chosen, None, None] * shape[1] + cell[..., 0]) * shape[2] + cell[..., 1]
        total += np.bincount(place[within], share[within], minlength=len(total))
    return total.reshape(shape)
