"""Ways round what moves: where a motion would meet it, its place then is an obstacle of the map.

Routes of that map pass the place on either side, and ways along them are timed like others; whether
they meet what moves is judged in time, not on this map.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.bodies.scene import BodyScene
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.movers import Discs, place_at

NEAR = 0.1  # m between the circle about the outline and what moves, at which they meet
EARLIER, MOMENTS = 0.45, 7  # s before a meeting and after it, and places in this time
KEPT_FREE = 0.1  # m about the robot's circle at the start and at the goal


def evading(problem: BodyScene, poses: FloatArray, durations: FloatArray) -> BodyScene:
    """Return the problem with the places taken at which motions would meet what moves.

    poses: [N, T, 3]; durations: [N] s
    """
    scene, reach = problem.scene, problem.body.outline.reach
    assert scene.movers is not None
    discs = Discs.of(scene.movers, np.float64)
    taken = np.zeros(scene.occupied.shape, np.bool_)
    corner = np.array(scene.origin, np.float64)
    _take_places(poses, durations, discs, reach, corner, scene.resolution, taken)
    for end in (problem.start, problem.goal):
        _mark(taken, False, end[0], end[1], reach + KEPT_FREE, corner, scene.resolution)
    cost_map = scene.cost_map.copy()
    cost_map[0][taken] = 1.0
    return replace(problem, scene=replace(scene, cost_map=cost_map))


@compiled
def _take_places(
    poses: FloatArray,
    durations: FloatArray,
    discs: Discs,
    reach: float,
    corner: FloatArray,
    resolution: float,
    taken: NDArray[np.bool_],
) -> None:
    """Mark the cells [H, W] that discs cover about the times at which motions meet them."""
    for n in range(len(poses)):
        stride = durations[n] / (poses.shape[1] - 1)
        for t in range(poses.shape[1]):
            for j in range(len(discs.radius)):
                x, y = place_at(discs, j, t * stride)
                radius = discs.radius[j] + discs.growth * t * stride
                away = np.hypot(poses[n, t, 0] - x, poses[n, t, 1] - y)
                if away > reach + radius + NEAR:
                    continue
                for k in range(MOMENTS):
                    time = t * stride + EARLIER * (2.0 * k / (MOMENTS - 1) - 1.0)
                    x, y = place_at(discs, j, max(time, 0.0))
                    _mark(taken, True, x, y, radius, corner, resolution)


@compiled
def _mark(
    cells: BoolArray,
    value: bool,
    x: float,
    y: float,
    radius: float,
    corner: FloatArray,
    resolution: float,
) -> None:
    """Set the cells [H, W] whose centres a disc covers."""
    u, v = (x - corner[0]) / resolution - 0.5, (y - corner[1]) / resolution - 0.5
    cover = radius / resolution
    for row in range(max(0, int(np.ceil(v - cover))), min(len(cells), int(v + cover) + 1)):
        half = np.sqrt(max(cover * cover - (row - v) ** 2, 0.0))
        first, last = max(0, int(np.ceil(u - half))), min(cells.shape[1], int(u + half) + 1)
        if first < last:
            cells[row, first:last] = value
