"""One sample of a trajectory file as the row of a scene dataset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.data.derivatives import HEADING
from anchorflow_training.data.trajectory_statistics import FIELDS
from anchorflow_training.dataset import Row, scene_row
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.scene import Scene, with_neutral_channels
from anchorflow_trajectory.spline import GOAL_POINTS, START_POINTS, SplineBasis, spline_basis
from anchorflow_trajectory.verify import path_clearance
from anchorflow_trajectory.warm_start import nearest_route

FloatArray = NDArray[np.floating]

CHANNELS = 3  # occupancy, traversability, risk: those that a network is told at least
STYLE = (0.4, 0.3, 0.3)  # safety, energy, smooth, where the file has no style_weights
REACHED = 0.1  # m from a given end to the trajectory's own
LEAST_POINTS = START_POINTS + GOAL_POINTS + 1
ROOM_SHARE, ROOM_M = 0.75, 3.0
"""Half the side of an empty map, in shares of what the trajectory spans, and metres beside it.

The network looks at a square around start and goal, and beyond a map's edge the robot may not be.
"""


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
    """One sample: its arrays without the N axis, its map's (origin x, origin y, resolution).

    duration: s that it lasts
    motion: what is asked of the scene; without a horizon the duration is the sample's own choice
    """

    arrays: Mapping[str, FloatArray]
    geometry: NDArray[np.float64] | None
    duration: float
    motion: MotionLimits
    options: SceneOptions


def imported_scene(source: SceneSource) -> Row | str:
    """The scene's arrays as `SceneDataset` keeps them, or why the sample is left out."""
    arrays, options = source.arrays, source.options
    fields = [arrays[name] for name in FIELDS]
    x_curr, x_goal = end_states(arrays)
    for state, position in zip((x_curr, x_goal), fields[0][[0, -1]], strict=True):
        if np.linalg.norm(state[:2] - position[:2]) > REACHED:
            return "missed_ends"
    if source.geometry is None:
        given, origin, resolution, centre = empty_map(fields[0], x_curr, x_goal, options.cells)
        # Where the map lies is ours to say; near the origin float32 resolves it best.
        fields[0] = fields[0] - centre
        x_curr, x_goal = (_moved(x, -centre) for x in (x_curr, x_goal))
    else:
        *corner, resolution = source.geometry.tolist()
        given, origin = arrays["cost_maps"], np.array(corner)
    style = np.asarray(arrays.get("style_weights", STYLE))
    scene = Scene(
        cost_map=with_neutral_channels(given, CHANNELS),
        resolution=resolution,
        origin=origin,
        robot_radius=options.robot_radius,
        x_curr=x_curr,
        x_goal=x_goal,
        w_style=style / style.sum(),
        motion=source.motion,
        basis=_basis(len(fields[0])),
    )
    if not all(scene.is_free(x[:2]) for x in (x_curr, x_goal)):
        return "off_map"
    if not options.keep_collisions:
        margin = float(arrays.get("safety_margins", np.zeros(())))
        positions = fields[0].astype(np.float32)[None]
        clearance = path_clearance(scene.cost_fields.clearance, positions)
        if clearance[0] < margin:
            return "collision"
    route = nearest_route(scene.route_states, fields[0])
    row = scene_row(
        scene,
        np.concatenate(fields, -1)[None],
        durations=np.array([source.duration]),
        route=np.array([route]),
    )
    if "quality" in arrays:
        row["quality"] = arrays["quality"].astype(np.float32).reshape(1)
    return row


def end_states(arrays: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """x_curr [3D] and x_goal [2D]: as the file gives them, else the trajectory's own ends."""
    p, v, a = (arrays[name] for name in FIELDS)
    x_curr = arrays.get("start_states", np.concatenate([p[0], v[0], a[0]]))
    x_goal = arrays.get("goal_states", np.concatenate([p[-1], v[-1]]))
    return _turned_on(x_curr, p[0]), _turned_on(x_goal, p[-1])


def empty_map(
    positions: FloatArray, x_curr: FloatArray, x_goal: FloatArray, cells: int
) -> tuple[FloatArray, NDArray[np.float64], float, FloatArray]:
    """Free ground around a trajectory [T, D]: map [1, H, W], origin, resolution, and its centre.

    The origin is for positions less the centre [D], which has no heading.
    """
    points = np.concatenate([positions[:, :2], x_curr[None, :2], x_goal[None, :2]])
    low, high = points.min(0), points.max(0)
    half = ROOM_SHARE * float((high - low).max()) + ROOM_M
    centre = np.zeros(positions.shape[1])
    centre[:2] = 0.5 * (low + high)
    return np.zeros((1, cells, cells)), np.full(2, -half), 2 * half / cells, centre


def _basis(num_steps: int) -> SplineBasis:
    """As a model's by default, with fewer control points where there are fewer steps."""
    usual = spline_basis(num_steps).num_control_points
    return spline_basis(num_steps, num_control_points=min(usual, max(num_steps, LEAST_POINTS)))


def _turned_on(state: FloatArray, end: FloatArray) -> FloatArray:
    """The state, its heading, if there is one, by whole turns nearest to that of the end [D]."""
    state = state.copy()
    turn = 2 * np.pi
    state[HEADING : len(end)] += turn * np.round((end - state[: len(end)])[HEADING:] / turn)
    return state


def _moved(state: FloatArray, by: FloatArray) -> FloatArray:
    moved = state.copy()
    moved[: len(by)] += by
    return moved
