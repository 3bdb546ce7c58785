"""The part of a map that `anchorflow plan` shows to the planner."""

from __future__ import annotations

import numpy as np

from anchorflow_cli.options import Vector
from anchorflow_cli.ros_map import RosMap
from anchorflow_client.contract.fields import MAX_MAP_CELLS, MIN_MAP_CELLS
from anchorflow_client.errors import AnchorFlowError

MARGIN_M = 3.0
"""Room for a detour beyond start and goal, on each side."""


class WindowError(AnchorFlowError):
    """No window of the map can hold start and goal."""


def map_window(
    ros_map: RosMap, start: Vector, goal: Vector, *, size_m: float | None, option: str = "--window"
) -> RosMap:
    """A square window with its centre between `start` and `goal` ([2] m each).

    `size_m` is its side; by default it is as long as the way is far, and a margin on both sides.
    `option` is what a command calls it.
    Raises `WindowError` where it would miss the ends or have more cells than the contract takes.
    """
    extent_m = float(np.abs(goal - start).max())
    if size_m is None:
        size_m = float(np.linalg.norm(goal - start)) + 2 * MARGIN_M
    elif not size_m > extent_m:
        raise WindowError(
            f"{option}: expected more than {extent_m:g} m, to hold start and goal, got {size_m:g}"
        )
    size_m = max(size_m, MIN_MAP_CELLS * ros_map.resolution)
    limit_m = MAX_MAP_CELLS * ros_map.resolution
    if size_m > limit_m:
        raise WindowError(
            f"expected a window of at most {limit_m:g} m ({MAX_MAP_CELLS} cells of "
            f"{ros_map.resolution:g} m), got {size_m:g} m; bring start and goal nearer together "
            f"or choose a smaller {option}"
        )
    return ros_map.crop((start + goal) / 2, size_m)
