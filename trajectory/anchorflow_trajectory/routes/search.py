"""The cheapest routes of a scene, one for each way round its obstacles and its dear patches.

A route is the path on the grid that costs least among those with its signature (`homotopy`): the
integral of 1 + surcharge along it, which on even ground is its length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.routes.dijkstra import (
    ROUNDING,
    STEPS,
    Cells,
    Entries,
    Ground,
    Keys,
    Lengths,
    Links,
    Steps,
    Ways,
    cell_index,
    free_steps,
    new_queue,
    only_entry,
    spread,
    step_cost,
    walked_back,
    ways_from,
)
from anchorflow_trajectory.routes.homotopy import ObstacleRays, Signature, in_cells

MOST_ROUTES = 12
STRETCH = 1.3
HARDLY = 1.2  # times the least length
DIAGONAL = 2.0**0.5
LOOKS_A_CELL = 2.0  # points of a straight line at which a map is looked up
SLACK = 0.02  # m beyond robot_radius that a route keeps, so that a spline along it can


@dataclass(frozen=True, eq=False)
class Route:
    """A way from start to goal.

    points: [K, 2] m, in the map's frame, from the start to the goal
    length: m, of the polyline through them
    signature: crossings of the ray of each obstacle, as `ObstacleRays` orders them
    charge: m, the integral of the surcharge along it
    """

    points: NDArray[np.float64]
    length: float
    signature: Signature
    charge: float = 0.0

    @property
    def cost(self) -> float:
        """m, the integral of 1 + surcharge."""
        return self.length + self.charge


def find_routes(
    clearance: FloatArray,
    *,
    resolution: float,
    origin: FloatArray,
    start: FloatArray,
    goal: FloatArray,
    most: int = MOST_ROUTES,
    stretch: float = STRETCH,
    slack: float = SLACK,
    rays: ObstacleRays | None = None,
    surcharge: FloatArray | None = None,
) -> list[Route]:
    """The cheapest routes on the grid with different signatures, the cheapest first.

    Empty if no way is free.

    Args:
        clearance: [H, W] m beyond robot_radius at cell centres, negative where the robot would
            touch something.
        resolution: m/cell.
        origin: [2] m, outer corner of cell (0, 0).
        start, goal: [2] m. Cells around them are free with less than `slack`, their own with any
            clearance, so that a robot close to an obstacle may leave.
        most: routes at most.
        stretch: times the cheapest that a route may cost.
        slack: m of clearance that routes keep.
        rays: of this clearance, if they are already known.
        surcharge: [H, W] >= 0, m of detour that a metre through a cell is worth; none: 0.

    Raises:
        ValueError: `most` is below 1, `stretch` below 1 or `slack` negative.
    """
    if most < 1 or not stretch >= 1.0 or not slack >= 0.0:
        raise ValueError(
            f"expected most >= 1, stretch >= 1 and slack >= 0, got {most}, {stretch} and {slack}"
        )
    height, width = clearance.shape
    ends = [cell_index(end, origin, resolution, (height, width)) for end in (start, goal)]
    free = free_cells(clearance, ends, slack=slack)
    rays, routes = rays or ObstacleRays.of(clearance, surcharge), []
    crossed, (first, last) = rays.keys_crossed().ravel(), ends
    dear = np.zeros(clearance.shape) if surcharge is None else surcharge.astype(np.float64)
    cells, parts = search_routes(
        free_steps(free), width, dear.ravel(), crossed, first, last, most, float(stretch)
    )
    at = (np.stack([cells % width, cells // width], -1) + 0.5) * resolution + origin
    for begin, end in pairwise(parts.tolist()):
        points = np.concatenate([[start], at[begin + 1 : end - 1], [goal]]).astype(np.float64)
        (signature,) = rays.signatures(points[None], resolution=resolution, origin=origin)
        on_grid = in_cells(points, resolution, origin)
        if surcharge is not None and not rays.is_simple(signature, on_grid[0], on_grid[-1]):
            continue
        charge = 0.0 if surcharge is None else resolution * charge_along(on_grid, dear)
        length = polyline_length(points)
        routes.append(Route(points, length, signature, charge))
    return sorted(routes, key=lambda route: route.cost)


def polyline_length(points: FloatArray) -> float:
    """m, through points [K, 2]."""
    legs = points[1:] - points[:-1]
    return float(np.sqrt((legs * legs).sum(1)).sum())


def place_along(points: FloatArray, way: float) -> tuple[FloatArray, FloatArray]:
    """Return [2] m, the place `way` m along a polyline [K, 2] or its end, and the direction [2]."""
    legs = np.diff(points, axis=0)
    length = np.hypot(*legs.T)
    marks = np.append(0.0, length.cumsum())
    leg = int(np.clip(np.searchsorted(marks, way) - 1, 0, len(legs) - 1))
    place = np.array([np.interp(way, marks, axis) for axis in points.T])
    return place, legs[leg] / max(float(length[leg]), 1e-9)


@compiled
def charge_along(points: FloatArray, surcharge: Lengths) -> float:
    """The integral [cells] of the surcharge [H, W] along a polyline [K, 2] in cells."""
    total = 0.0
    for leg in range(len(points) - 1):
        total += charge_of_leg(points[leg], points[leg + 1], surcharge)
    return total


@compiled_part
def charge_of_leg(begin: FloatArray, end: FloatArray, surcharge: Lengths) -> float:
    """The integral [cells] of the surcharge [H, W] along the straight line [2] to [2] in cells."""
    height, width = surcharge.shape
    across, up = end[0] - begin[0], end[1] - begin[1]
    looks = int(LOOKS_A_CELL * max(abs(across), abs(up))) + 1
    total = 0.0
    for look in range(looks):
        share = (look + 0.5) / looks
        column, row = int(begin[0] + share * across), int(begin[1] + share * up)
        total += surcharge[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]
    return total / looks * np.sqrt(across * across + up * up)


def free_cells(clearance: FloatArray, ends: Sequence[int], *, slack: float) -> BoolArray:
    """[H, W], the cells that routes may take between two flat cells."""
    free = clearance >= slack
    for row, column in (divmod(end, clearance.shape[1]) for end in ends):
        about = (slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2))
        free[about] |= clearance[about] >= 0.0
        free[row, column] = True
    return free


class Cuts(NamedTuple):
    """The steps [H * W] across the cuts, how many there are, and what keys are made of.

    crossed: [H * W] what a step to the right adds; onward: [H * W] what the shortest way to the
        goal adds
    """

    steps: Steps
    total: int
    crossed: Keys
    onward: Keys


@compiled
def search_routes(
    steps: Steps,
    width: int,
    surcharge: Lengths,
    crossed: Keys,
    start: int,
    goal: int,
    most: int,
    stretch: float,
) -> tuple[Cells, Cells]:
    """The cells [P] of all routes, one after the other, and where each begins and ends: [R + 1].

    The cheapest comes first. There is none where no way leads to the goal.

    Args:
        steps: [H * W] between free cells (`free_steps`).
        width: W.
        surcharge: [H * W] of each cell.
        crossed: [H * W] what a step from each cell to the right adds to a signature's key.
        start, goal: flat cells.
        most: routes at most.
        stretch: times the cheapest that a route may cost.
    """
    offsets, queue = STEPS[:, 0] * width + STEPS[:, 1], new_queue(surcharge)
    cells, ends, found = np.empty(0, np.int64), np.zeros(most + 1, np.int64), 0
    least = _least_ways(goal, width, len(steps))
    # Most ways are hardly longer than on free ground, and few cells are then worth a look.
    guess = HARDLY * least[start]
    about = Ground(steps, offsets, surcharge, least, stretch * guess + ROUNDING)
    from_start = ways_from(start, about, queue)[0].lengths[0]
    if from_start[goal] > guess:
        everywhere = Ground(steps, offsets, surcharge, least, np.inf)
        from_start = ways_from(start, everywhere, queue)[0].lengths[0]
    limit = stretch * from_start[goal] + ROUNDING
    if not np.isfinite(limit):
        return cells, ends[:1]
    # If a cell's way is short enough, so are those of the cells between it and the goal.
    to_goal, near = ways_from(goal, Ground(steps, offsets, surcharge, from_start, limit), queue)
    inside, cuts = _cut(near, steps, offsets, to_goal.links[0], crossed)
    ground = Ground(inside, offsets, surcharge, to_goal.lengths[0], limit)

    pending, known = only_entry(start), np.empty(most, np.uint64)
    ways = Ways(np.empty((most, len(steps))), np.empty((most, len(steps)), np.int32))
    while len(pending.keys):
        best = np.argmin(pending.lengths + ground.rest[pending.cells])
        key, cell = pending.keys[best], pending.cells[best]
        sheet = _place(key, known[:found])
        if sheet == found:
            known[sheet], ways.lengths[sheet] = key, np.inf
            before = walked_back(cell, pending.links[best], ways.links, ground)
            after = walked_back(cell, to_goal.links[0, cell], to_goal.links, ground)
            cells = np.concatenate((cells, before[::-1], after[1:]))
            found += 1
            ends[found] = len(cells)
        if found == most:
            break
        chosen = pending.keys == key
        reached = spread(_kept(pending, chosen), ground, queue, sheet, ways)
        left = _left(reached, ground, cuts, sheet, known[:found], ways.lengths)
        pending = _joined(_kept(pending, ~chosen), left)
    return cells, ends[: found + 1]


@compiled_part
def _least_ways(goal: int, width: int, count: int) -> Lengths:
    """Return the least lengths [H * W] of ways from cells to the goal, as on free ground."""
    least, (goal_row, goal_column) = np.empty(count), divmod(goal, width)
    for cell in range(count):
        row, column = divmod(cell, width)
        up, across = abs(row - goal_row), abs(column - goal_column)
        least[cell] = max(up, across) + (DIAGONAL - 1.0) * min(up, across)
    return least


@compiled_part
def _cut(
    near: Cells, steps: Steps, offsets: Cells, links: Links, crossed: Keys
) -> tuple[Steps, Cuts]:
    """The steps [H * W] between near cells that stay in their sheet, and the others.

    near: from the goal on, those first that the ways of others lead over
    links: [H * W] of the ways from the goal
    """
    keys, is_near = np.zeros(len(steps), np.uint64), np.zeros(len(steps), np.bool_)
    is_near[near] = True
    for cell in near[1:]:
        step = int(links[cell])
        head = cell - offsets[step]
        keys[cell] = keys[head] - _change(crossed, head, cell, step)
    inside, across, count = np.zeros_like(steps), np.zeros_like(steps), 0
    for cell in near:
        for k in range(len(STEPS)):
            head = cell + offsets[k]
            if not (steps[cell] >> k) & 1 or not is_near[head]:
                continue
            if _change(crossed, cell, head, k) + keys[head] == keys[cell]:
                inside[cell] |= np.uint8(1 << k)
            else:
                across[cell] |= np.uint8(1 << k)
                count += 1
    return inside, Cuts(across, count, crossed, keys)


@compiled_part
def _change(crossed: Keys, cell: int, head: int, step: int) -> np.uint64:
    """Return what a step from a cell to another adds to a signature's key."""
    if STEPS[step, 1] > 0:
        return crossed[cell]
    if STEPS[step, 1] < 0:
        return np.uint64(0) - crossed[head]
    return np.uint64(0)


@compiled_part
def _left(
    reached: Cells, ground: Ground, cuts: Cuts, sheet: int, known: Keys, lengths: Lengths
) -> Entries:
    """The entries into other sheets from the cells that a sheet reaches now.

    known: [S] keys of the sheets; lengths: [S or more, H * W] of their ways
    """
    keys, cells = np.empty(cuts.total, np.uint64), np.empty(cuts.total, np.int64)
    until, links, count = np.empty(cuts.total), np.empty(cuts.total, np.int32), 0
    for cell in reached:
        for k in range(len(STEPS)):
            if not (cuts.steps[cell] >> k) & 1:
                continue
            head = cell + ground.offsets[k]
            length = lengths[sheet, cell] + step_cost(ground.surcharge, cell, head, k)
            if length + ground.rest[head] > ground.limit:
                continue
            change = _change(cuts.crossed, cell, head, k) + cuts.onward[head] - cuts.onward[cell]
            key = known[sheet] + change
            other = _place(key, known)
            if other < len(known) and length >= lengths[other, head] - ROUNDING:
                continue
            keys[count], cells[count] = key, head
            until[count], links[count] = length, len(STEPS) * sheet + k
            count += 1
    return Entries(keys[:count], cells[:count], until[:count], links[:count])


@compiled_part
def _place(key: np.uint64, keys: Keys) -> int:
    """Return the index of a key in keys [S], or S."""
    for place in range(len(keys)):
        if keys[place] == key:
            return place
    return len(keys)


@compiled_part
def _kept(entries: Entries, chosen: NDArray[np.bool_]) -> Entries:
    """Those of the entries [E] that are chosen."""
    return Entries(
        entries.keys[chosen],
        entries.cells[chosen],
        entries.lengths[chosen],
        entries.links[chosen],
    )


@compiled_part
def _joined(some: Entries, more: Entries) -> Entries:
    """Both, one after the other."""
    return Entries(
        np.concatenate((some.keys, more.keys)),
        np.concatenate((some.cells, more.cells)),
        np.concatenate((some.lengths, more.lengths)),
        np.concatenate((some.links, more.links)),
    )
