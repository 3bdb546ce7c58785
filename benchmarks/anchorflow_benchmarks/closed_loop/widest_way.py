"""How much a world's widest way leaves a robot to spare at its narrowest place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.spatial import KDTree

Array = NDArray[np.float64]

CELL = 0.03  # m: what is found lies at most half a cell's diagonal below the truth
MARGIN = 1.5  # m round posts and ends, where there is nothing in the way
EIGHT_NEIGHBOURS = np.ones((3, 3), bool)
HALVINGS = 12


def widest_way(
    posts: Array, post_radius: float, start: Array, goal: Array, *, most: float = 2.0
) -> float:
    """m between the rims of posts and the centre of what takes the widest way, at its narrowest.

    posts: [M, 2] m; start, goal: [2] m; most: m, from which on all is as good
    """
    ends = np.stack([start, goal])
    points = np.concatenate([posts, ends])
    low = points.min(0) - MARGIN
    width, height = np.ceil((points.max(0) + MARGIN - low) / CELL).astype(int)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = low + CELL * np.stack([x, y], -1)
    if not len(posts):
        return most
    nearest, _ = KDTree(posts).query(centres.reshape(-1, 2), distance_upper_bound=2 * most)
    room = np.minimum(nearest.reshape(height, width) - post_radius, most)
    (start_column, start_row), (goal_column, goal_row) = ((ends - low) / CELL).astype(int)
    narrow, wide = 0.0, float(min(room[start_row, start_column], room[goal_row, goal_column]))
    parts = np.zeros(room.shape, np.int32)
    for _ in range(HALVINGS):
        tried = 0.5 * (narrow + wide)
        label(room >= tried, EIGHT_NEIGHBOURS, output=parts)
        if parts[start_row, start_column] == parts[goal_row, goal_column] > 0:
            narrow = tried
        else:
            wide = tried
    return narrow
