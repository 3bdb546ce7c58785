"""The local goal: where to plan to on a map that may end before the goal, or not know it free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OCCUPIED, CostMap
from anchorflow_client.errors import InvalidRequest

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

PLANE = 2  # x and y; a heading in a goal is left as it is
MOVING = 1e-9  # m, a way along an axis that leads anywhere


def local_goal(
    cost_map: CostMap,
    position: Array,
    x_goal: Array,
    *,
    clearance_m: float,
    through_speed: float,
    passage_m: float | None = None,
) -> Array:
    """The goal itself where it can be stood on, else the nearest place towards it that can.

    1. The aim is the goal or, where that is not at least `clearance_m` inside the map, the last
       point of the straight line from `position` to it that is.
    2. A cell is free where no occupied cell's centre lies within `clearance_m` of its own and the
       map's edge is further away than that.
    3. Free cells count that the robot can reach through cells which keep `passage_m`, to all four
       sides; all of them where it can reach none.
    4. An aim in such a cell is taken; otherwise the centre of the nearest of them is.
    5. A goal beyond the map is passed towards, not stopped at: its velocity becomes
       `through_speed` in the direction of the goal. One on the map keeps its own.

    Args:
        cost_map: of a single scene, [C,H,W].
        position: [2] m, of the robot, on the map.
        x_goal: [2D] position in m, velocity in m/s.
        clearance_m: what to keep from obstacles, and from the map's edge.
        through_speed: m/s.
        passage_m: what the way there has to keep from obstacles; as `clearance_m` unless told.

    Returns:
        [2D], a new array.

    Raises:
        InvalidRequest: no cell of the map is free.
    """
    goal = np.array(x_goal, dtype=np.float64)
    target = goal[:PLANE].copy()
    share = _share_on_map(cost_map, position, target, clearance_m)
    aim = position + share * (target - position)
    free = _free_cells(cost_map, clearance_m)
    if not free.any():
        raise InvalidRequest(
            f"expected a cell that is {clearance_m:g} m away from every obstacle and from the "
            "map's edge, to plan to; got none",
            "cost_map.data",
        )
    passable = free if passage_m is None else _free_cells(cost_map, passage_m)
    reached = free & _connected(passable, cost_map.cell_of(*position.tolist()))
    goal[:PLANE] = _nearest(cost_map, reached if reached.any() else free, aim)
    if share < 1.0:
        way = target - goal[:PLANE]
        dim = len(goal) // 2
        goal[dim : dim + PLANE] = through_speed * way / max(float(np.linalg.norm(way)), MOVING)
    return goal


def _share_on_map(cost_map: CostMap, position: Array, target: Array, margin: float) -> float:
    """How much of the line to the target is at least `margin` inside the map, in [0, 1]."""
    low, high = cost_map.extent + margin * np.array([[1.0], [-1.0]])
    way = target - position
    bound = np.where(way > 0, high, low)
    moving = np.abs(way) > MOVING
    shares = (bound - position)[moving] / way[moving]
    return float(np.clip(shares.min(initial=1.0), 0.0, 1.0))


def _nearest(cost_map: CostMap, cells: BoolArray, aim: Array) -> Array:
    row, column = cost_map.cell_of(*aim.tolist())
    if cells[row, column]:
        return aim
    rows, columns = np.nonzero(cells)
    centres = cost_map.origin + cost_map.resolution * (np.stack([columns, rows], axis=1) + 0.5)
    return centres[((centres - aim) ** 2).sum(axis=1).argmin()]


def _connected(passable: BoolArray, start: tuple[int, int]) -> BoolArray:
    """[H, W], the passable cells that hang together with the one nearest to the start's."""
    cells = np.argwhere(passable)
    if not len(cells):
        return passable
    reached = np.zeros(passable.shape, np.bool_)
    reached[tuple(cells[((cells - start) ** 2).sum(1).argmin()])] = True
    before = 0
    while (count := int(reached.sum())) > before:
        before = count
        # Sweeps carry what is reached as far as a row or a column goes.
        for grid, open_cells in ((reached, passable), (reached.T, passable.T)):
            for rows in (range(1, len(grid)), range(len(grid) - 2, -1, -1)):
                step = 1 if rows.step < 0 else -1
                for row in rows:
                    grid[row] |= grid[row + step] & open_cells[row]
    return reached


def _free_cells(cost_map: CostMap, clearance_m: float) -> BoolArray:
    """[H,W], cells that keep `clearance_m` from occupied ones and from the edge."""
    reach = int(clearance_m / cost_map.resolution)
    occupied = cost_map.occupancy >= OCCUPIED
    height, width = occupied.shape
    padded = np.pad(occupied, reach, constant_values=True)
    near = np.zeros_like(occupied)
    for rows, columns in _disc(clearance_m / cost_map.resolution, reach):
        near |= padded[
            reach + rows : reach + rows + height, reach + columns : reach + columns + width
        ]
    return ~near


def _disc(radius: float, reach: int) -> list[tuple[int, int]]:
    """Offsets (row, column) of at most `radius` cells."""
    steps = range(-reach, reach + 1)
    return [(i, j) for i in steps for j in steps if i * i + j * j <= radius * radius]
