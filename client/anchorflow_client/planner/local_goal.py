"""The local goal: where to plan to on a map that may end before the goal, or not know it free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OCCUPIED, CostMap
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.planner.clearance import obstacle_distance

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
    2. A cell is passable where its centre keeps `passage_m` from every occupied cell, measured to
       its square as the service does, and from the map's edge. It is free where moreover no
       occupied cell's centre, nor the map's edge, lies within `clearance_m` of its own.
    3. Free cells count that the robot can reach through passable ones, to all four sides, from the
       first of these on its way through unoccupied cells. Where there is none, the passable ones
       that it can reach count or, where it can reach none of these either, all free ones.
    4. An aim in such a cell, which itself keeps `passage_m` from obstacles, is taken; otherwise the
       centre of the nearest of them is.
    5. A goal beyond the map is passed towards, not stopped at: its velocity becomes
       `through_speed` in the direction of the goal. One on the map keeps its own.

    Args:
        cost_map: of a single scene, [C,H,W].
        position: [2] m, of the robot, on the map.
        x_goal: [2D] position in m, velocity in m/s.
        clearance_m: what to keep from obstacles, and from the map's edge.
        through_speed: m/s.
        passage_m: what the way there and the goal have to keep from obstacles; None: not known,
            and free cells alone are passable.

    Returns:
        [2D], a new array.

    Raises:
        InvalidRequest: no cell of the map is free.
    """
    goal = np.array(x_goal, dtype=np.float64)
    target = goal[:PLANE].copy()
    share = _share_on_map(cost_map, position, target, clearance_m)
    aim = position + share * (target - position)
    free = passable = _free_cells(cost_map, clearance_m)
    if passage_m is not None:
        passable = _free_cells(cost_map, passage_m, to_squares=True)
        free = free & passable
    occupied = cost_map.occupancy >= OCCUPIED
    reached = _connected(
        passable, _first_reached(passable, occupied, cost_map.cell_of(*position.tolist()))
    )
    standing = next((cells for cells in (free & reached, reached, free) if cells.any()), None)
    if standing is None:
        raise InvalidRequest(
            f"expected a cell that is {clearance_m:g} m away from every obstacle and from the "
            "map's edge, to plan to; got none",
            "cost_map.data",
        )
    goal[:PLANE] = _nearest(cost_map, standing, aim, passage_m or 0.0)
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


def _nearest(cost_map: CostMap, cells: BoolArray, aim: Array, passage_m: float) -> Array:
    row, column = cost_map.cell_of(*aim.tolist())
    if cells[row, column] and obstacle_distance(cost_map, aim) >= passage_m:
        return aim
    rows, columns = np.nonzero(cells)
    centres = cost_map.origin + cost_map.resolution * (np.stack([columns, rows], axis=1) + 0.5)
    return centres[((centres - aim) ** 2).sum(axis=1).argmin()]


def _first_reached(passable: BoolArray, occupied: BoolArray, start: tuple[int, int]) -> BoolArray:
    """[H, W], the passable cells that come first on the ways from the start's, walls in between."""
    reached = np.zeros(passable.shape, np.bool_)
    reached[start] = True
    before = 0
    while not (reached & passable).any() and (count := int(reached.sum())) > before:
        before = count
        grown = np.pad(reached, 1)
        beside = grown[:-2, 1:-1] | grown[2:, 1:-1] | grown[1:-1, :-2] | grown[1:-1, 2:]
        reached |= beside & ~occupied
    return reached & passable


def _connected(passable: BoolArray, begun: BoolArray) -> BoolArray:
    """[H, W], the passable cells that hang together with those that are begun from."""
    reached = begun.copy()
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


def _free_cells(cost_map: CostMap, clearance_m: float, *, to_squares: bool = False) -> BoolArray:
    """[H,W], cells whose centres keep `clearance_m` from occupied ones and from the edge.

    to_squares: measured to the occupied cells' squares, not to their centres
    """
    occupied = cost_map.occupancy >= OCCUPIED
    disc = _disc(clearance_m / cost_map.resolution, to_squares=to_squares)
    reach = max(rows for rows, _ in disc)
    height, width = occupied.shape
    padded = np.pad(occupied, reach, constant_values=True)
    near = np.zeros_like(occupied)
    for rows, columns in disc:
        near |= padded[
            reach + rows : reach + rows + height, reach + columns : reach + columns + width
        ]
    return ~near


def _disc(radius: float, *, to_squares: bool) -> list[tuple[int, int]]:
    """Offsets (row, column) of cells whose centres, or squares, lie within so many cells."""
    half = 0.5 if to_squares else 0.0
    steps = range(-int(radius + half), int(radius + half) + 1)
    far = {i: max(abs(i) - half, 0.0) for i in steps}
    return [(i, j) for i in steps for j in steps if far[i] ** 2 + far[j] ** 2 <= radius * radius]
