"""One sample of a trajectory file as the row of a scene dataset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.data.trajectory_statistics import FIELDS
from anchorflow_trajectory.clearance import GridField, clearance_field, path_clearance
from anchorflow_trajectory.geodesic import cost_to_go

FloatArray = NDArray[np.floating]
Row = dict[str, NDArray[Any]]

OCCUPIED = 0.5  # occupancy from which a cell is an obstacle
STYLE = (0.4, 0.3, 0.3)  # safety, energy, smooth, where the file has no style_weights
NEUTRAL = (0.0, 1.0, 0.0)  # occupancy, traversability, risk of ground that nobody described
ROOM_SHARE, ROOM_M = 0.75, 3.0
"""Half the side of an empty map, in shares of what the trajectory spans, and metres beside it.

The network looks at a square around start and goal, and beyond a map's edge the robot may not be.
"""
MOST_FLOAT16 = float(np.finfo(np.float16).max)
CHECK_STEP = 0.05  # m along the path between two checks of its clearance


@dataclass(frozen=True)
class SceneOptions:
    """How a sample becomes a scene.

    robot_radius: m; cells: H = W of the empty map of a sample that has none
    keep_collisions: keep samples that touch an obstacle or come nearer than their safety margin
    """

    robot_radius: float = 0.25
    cells: int = 64
    keep_collisions: bool = False


@dataclass(frozen=True)
class SceneSource:
    """One sample: its arrays without the N axis, its map's (origin x, origin y, resolution)."""

    arrays: Mapping[str, FloatArray]
    geometry: NDArray[np.float64] | None
    options: SceneOptions


def imported_scene(source: SceneSource) -> Row | str:
    """The scene's arrays as `SceneDataset` keeps them, or why the sample is left out."""
    arrays, options = source.arrays, source.options
    fields = [arrays[name] for name in FIELDS]
    x_curr, x_goal = end_states(arrays)
    if source.geometry is None:
        cost_map, origin, resolution, centre = empty_map(fields[0], x_curr, x_goal, options.cells)
        # Where the map lies is ours to say; near the origin float32 resolves it best.
        fields[0] = fields[0] - centre
        x_curr, x_goal = (_moved(x, -centre) for x in (x_curr, x_goal))
    else:
        *corner, resolution = source.geometry.tolist()
        cost_map, origin = neutral_channels(arrays["cost_maps"]), np.array(corner)
    occupied = cost_map[0] >= OCCUPIED
    if not all(_on_free_ground(x[:2], occupied, origin, resolution) for x in (x_curr, x_goal)):
        return "off_map"
    clearance = clearance_field(occupied, resolution, options.robot_radius)
    if not options.keep_collisions:
        margin = float(arrays.get("safety_margins", np.zeros(())))
        field = GridField(clearance, resolution, origin)
        positions = fields[0].astype(np.float32)[None]
        if path_clearance(field, positions, max_step=CHECK_STEP)[0] < margin:
            return "collision"
    ways = cost_to_go(clearance, resolution, origin, x_curr[:2], x_goal[:2])
    style = np.asarray(arrays.get("style_weights", STYLE))
    row = {
        "cost_map": np.rint(cost_map * 255).astype(np.uint8),
        "clearance": clearance.astype(np.float16),
        "cost_to_go": np.minimum(ways, MOST_FLOAT16).astype(np.float16),
        "map_geometry": np.array([*origin, resolution], np.float32),
        "x_curr": x_curr.astype(np.float32),
        "x_goal": x_goal.astype(np.float32),
        "w_style": (style / style.sum()).astype(np.float32),
        "states": np.concatenate(fields, -1).astype(np.float32)[None],
    }
    if "quality" in arrays:
        row["quality"] = arrays["quality"].astype(np.float32).reshape(1)
    return row


def end_states(arrays: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """x_curr [3D] and x_goal [2D]: as the file gives them, else the trajectory's own ends."""
    p, v, a = (arrays[name] for name in FIELDS)
    x_curr = arrays.get("start_states", np.concatenate([p[0], v[0], a[0]]))
    x_goal = arrays.get("goal_states", np.concatenate([p[-1], v[-1]]))
    return x_curr, x_goal


def empty_map(
    positions: FloatArray, x_curr: FloatArray, x_goal: FloatArray, cells: int
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Free ground around a trajectory [T, D]: map [3, H, W], origin, resolution, and its centre.

    The origin is for positions less the centre [D], which has no heading.
    """
    points = np.concatenate([positions[:, :2], x_curr[None, :2], x_goal[None, :2]])
    low, high = points.min(0), points.max(0)
    half = ROOM_SHARE * float((high - low).max()) + ROOM_M
    centre = np.zeros(positions.shape[1])
    centre[:2] = 0.5 * (low + high)
    cost_map = np.ones((len(NEUTRAL), cells, cells)) * np.array(NEUTRAL)[:, None, None]
    return cost_map, np.full(2, -half), 2 * half / cells, centre


def neutral_channels(cost_map: FloatArray) -> FloatArray:
    """The map [C, H, W] with the channels that it lacks, neutral."""
    missing = NEUTRAL[len(cost_map) :]
    layers = [np.full((1, *cost_map.shape[1:]), value) for value in missing]
    return np.concatenate([cost_map, *layers])


def _moved(state: FloatArray, by: FloatArray) -> FloatArray:
    moved = state.copy()
    moved[: len(by)] += by
    return moved


def _on_free_ground(
    point: FloatArray, occupied: NDArray[np.bool_], origin: FloatArray, resolution: float
) -> bool:
    column, row = np.floor((point - origin) / resolution).astype(int)
    height, width = occupied.shape
    return bool(0 <= row < height and 0 <= column < width and not occupied[row, column])
