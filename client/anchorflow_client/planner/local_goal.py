"""The local goal: where to plan to on a map that may end before the goal, or show it occupied."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OCCUPIED, CostMap
from anchorflow_client.errors import InvalidRequest

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SHARE_OF_CELL = 0.3
"""Share of a cell that the service requires beyond the certified margin, for other readers'
rounding (`anchorflow_trajectory.finish.certificate`)."""
PLANE = 2  # x and y; a heading in a goal is left as it is
MOVING = 1e-9  # m, the shortest displacement along an axis that counts


def local_goal(
    cost_map: CostMap,
    position: Array,
    x_goal: Array,
    *,
    clearance_m: float,
    through_speed: float,
    passage_m: float | None = None,
) -> Array:
    """Return the goal itself if a robot can stand on it, else the nearest place where it can.

    1. The aim is the goal or, if that is not at least `clearance_m` inside the map, the last
       point of the straight line from `position` to it that is.
    2. A cell is passable if its centre keeps `passage_m` from every occupied cell, measured to
       its square as the service does, and from the map's edge. It is free if moreover no
       occupied cell's centre, nor the map's edge, lies within `clearance_m` of its own.
    3. Free cells count that the robot can reach through passable ones, to all four sides, from the
       first of these on its way through unoccupied cells. If there is none, the passable ones
       that it can reach count or, if it can reach none of these either, all free ones.
    4. An aim in such a cell, which itself keeps `passage_m` from obstacles, is taken; otherwise the
       centre of the nearest of them is.
    5. The robot passes a goal beyond the map and does not stop at it: its velocity becomes
       `through_speed` in the direction of the goal. A goal on the map keeps its own.

    Args:
        cost_map: a single scene's map, [C,H,W].
        position: [2] m, the robot's position, on the map.
        x_goal: [2D] position in m, velocity in m/s.
        clearance_m: distance to keep from obstacles, and from the map's edge.
        through_speed: m/s.
        passage_m: distance that the way and the goal have to keep from obstacles; None: unknown,
            and only free cells are passable.

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


def obstacle_distance(cost_map: CostMap, place: Array) -> float:
    """Return m from a place [2] to the nearest occupied cell of a map [C,H,W], or infinity.

    Bilinear between the four cell centres around the place, each measured to the nearest occupied
    square; centres inside obstacles are negative. The service measures the square whose centre is
    nearest, and may find 0.21 of a cell more.
    """
    occupied = cost_map.occupancy >= OCCUPIED
    if not occupied.any():
        return np.inf
    last = np.array(occupied.shape[::-1]) - 1
    at = np.clip((place - cost_map.origin) / cost_map.resolution - 0.5, 0, last)
    low = np.minimum(at.astype(int), last - 1)
    share = at - low
    distance = 0.0
    for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column, row = low[0] + x, low[1] + y
        weight = abs(1 - x - share[0]) * abs(1 - y - share[1])
        distance += weight * _signed_distance(occupied, row, column)
    return distance * cost_map.resolution


def start_clearance(cost_map: CostMap, place: Array, robot_radius: float) -> float:
    """Return m between a robot at a place [2] and the nearest obstacle or map edge.

    The distance to the edge is measured from the robot's centre.
    """
    low, high = cost_map.extent
    to_edge = float(np.minimum(place - low, high - place).min())
    return min(obstacle_distance(cost_map, place) - robot_radius, to_edge)


def _share_on_map(cost_map: CostMap, position: Array, target: Array, margin: float) -> float:
    """Return the share of the line to the target that is at least `margin` inside the map."""
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
    """Return [H,W], the first passable cells on the ways from `start` through unoccupied cells."""
    reached = np.zeros(passable.shape, np.bool_)
    reached[start] = True
    before = 0
    while not (reached & passable).any() and (count := int(reached.sum())) > before:
        before = count
        grown = np.pad(reached, 1)
        beside = grown[:-2, 1:-1] | grown[2:, 1:-1] | grown[1:-1, :-2] | grown[1:-1, 2:]
        reached |= beside & ~occupied
    return reached & passable


def _connected(passable: BoolArray, seeds: BoolArray) -> BoolArray:
    """Return [H,W], the passable cells that are connected to the seeds."""
    reached = seeds.copy()
    before = 0
    while (count := int(reached.sum())) > before:
        before = count
        # Each sweep extends the reached cells along whole rows or columns.
        for grid, open_cells in ((reached, passable), (reached.T, passable.T)):
            for rows in (range(1, len(grid)), range(len(grid) - 2, -1, -1)):
                step = 1 if rows.step < 0 else -1
                for row in rows:
                    grid[row] |= grid[row + step] & open_cells[row]
    return reached


def _free_cells(cost_map: CostMap, clearance_m: float, *, to_squares: bool = False) -> BoolArray:
    """Return [H,W], cells whose centres keep `clearance_m` from occupied ones and from the edge.

    to_squares: measure to the occupied cells' squares, not to their centres
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
    """Return offsets (row, column) of cells whose centres, or squares, lie within the radius."""
    half = 0.5 if to_squares else 0.0
    steps = range(-int(radius + half), int(radius + half) + 1)
    far = {i: max(abs(i) - half, 0.0) for i in steps}
    return [(i, j) for i in steps for j in steps if far[i] ** 2 + far[j] ** 2 <= radius * radius]


def _signed_distance(occupied: BoolArray, row: int, column: int) -> float:
    """Return the distance in cells from a cell's centre to the squares of the other kind."""
    inside = bool(occupied[row, column])
    apart = np.abs(np.argwhere(occupied != inside) - (row, column)) - 0.5
    squared = (np.maximum(apart, 0.0) ** 2).sum(1).min(initial=sum(occupied.shape) ** 2)
    return -float(np.sqrt(squared)) if inside else float(np.sqrt(squared))
