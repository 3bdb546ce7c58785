"""The boxes of a pair: who else is on the road, in the world.

Of a cooperative label only the type and `world_8_points` are sound; length, width and heading come
from the points' footprint.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.window import Vehicle
from anchorflow_training.data.pose_files import read_json
from anchorflow_training.dataset import DatasetError

Array = NDArray[np.float64]

EGO = Vehicle(4.6, 1.9)
"""The ego's box, m, which a recording does not tell."""
OWN = 1.5
"""m between a box's middle and the ego's, within which the box is the ego's own."""


def read_boxes(file: Path) -> Array:
    """[n,5] x, y [m], heading [rad], length, width [m] of a label's boxes.

    Raises:
        DatasetError: naming the file, the entry and what is wrong with it.
    """
    entries = read_json(file)
    if not isinstance(entries, list):
        raise DatasetError(f"{file}: expected a list of boxes, found {type(entries).__name__}")
    return np.array([_box(file, number, entry) for number, entry in enumerate(entries)]).reshape(
        -1, 5
    )


def without_own(boxes: Array, pose: Array) -> Array:
    """The boxes but for that of the vehicle at a pose [3], which the roadside sees as well."""
    away = np.linalg.norm(boxes[:, :2] - EGO.middles(pose)[:2], axis=1)
    return boxes[away > OWN]


def _box(file: Path, number: int, entry: Any) -> Array:
    where = f"{file}: box {number}: world_8_points"
    try:
        points = np.asarray(entry["world_8_points"], float)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{where}: expected 8 points [8,3] ({error})") from error
    if points.shape != (8, 3) or not np.isfinite(points).all():
        raise DatasetError(f"{where}: expected 8 points [8,3], found {list(points.shape)}")
    # The order of corners differs between copies: the four lowest are the footprint.
    footprint = points[np.argsort(points[:, 2], kind="stable")[:4], :2]
    middle = footprint.mean(0)
    angles = np.arctan2(*(footprint - middle).T[::-1])
    ring = footprint[np.argsort(angles)]
    sides = np.roll(ring, -1, 0) - ring
    lengths = np.linalg.norm(sides, axis=1)
    longest = int(lengths.argmax())
    heading = np.arctan2(sides[longest, 1], sides[longest, 0])
    return np.array([*middle, heading, lengths[longest], lengths[(longest + 1) % 4]])
