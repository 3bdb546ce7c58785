"""Ways of a body: A* over poses, each as it is driven and not rounded to a cell.

After Dolgov et al., "Path planning for autonomous vehicles in unknown semi-structured
environments", International Journal of Robotics Research 29, 2010. A search follows a route of the
map: what is left of a way is counted along it, and what lies beside it counts more. So each route
gives a way of its own, if the body fits through it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.bodies.outline import Ground, touches
from anchorflow_trajectory.bodies.shots import Target, direct_way
from anchorflow_trajectory.bodies.wheels import STANDING, Moves
from anchorflow_trajectory.compiled import compiled

GREED = 1.4  # factor on what is left
ASIDE = 1.6  # m of way that a metre beside the route counts
LEAST_TABLE = 1 << 10  # places for poses, a power of two
MOST_NODES = 60_000
ROWS, BINS = 1 << 20, 128  # bounds of what a key holds
NEAR = 3.0  # m from the goal within which it is tried directly
FURTHER, MUCH_FURTHER = 300, 2500  # poses expanded after a first way, and after a long one
LONG = 1.5  # times what a way seems to cost at least; such a loop may be saved by reversing
SHOT_EVERY = 3  # poses near the goal
EMPTY = -1


class Guide(NamedTuple):
    """What is left of a way along a route, by cells that are worked out when they are first met.

    left: [H, W] m at cell centres, below 0 where it is not known yet
    x, y: m, its corner; resolution: m/cell
    points: [K, 2] m of the route; rest: [K] m from each on
    """

    left: NDArray[np.float32]
    x: float
    y: float
    resolution: float
    points: NDArray[np.float64]
    rest: NDArray[np.float64]


class Nodes(NamedTuple):
    """What is reached: poses [K, 3], costs [K], ways driven since the start [K] m, and from where.

    moves: [K] the motion that led there; gears: [K]
    """

    poses: NDArray[np.float64]
    costs: NDArray[np.float64]
    driven: NDArray[np.float64]
    parents: NDArray[np.int64]
    moves: NDArray[np.int64]
    gears: NDArray[np.int64]


def guide_along(
    points: FloatArray, rest: FloatArray, shape: tuple[int, int], corner: FloatArray, cell: float
) -> Guide:
    """Return the guide [H, W] along a route through points [K, 2], with `rest` [K] m from each."""
    left = np.full(shape, -1.0, np.float32)
    points, rest = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(rest, np.float64)
    return Guide(left, float(corner[0]), float(corner[1]), cell, points, rest)


@compiled
def _left(guide: Guide, pose: FloatArray) -> float:
    """m that are left of the way in the cell of a pose."""
    row = int((pose[1] - guide.y) / guide.resolution)
    column = int((pose[0] - guide.x) / guide.resolution)
    row = min(max(row, 0), guide.left.shape[0] - 1)
    column = min(max(column, 0), guide.left.shape[1] - 1)
    if guide.left[row, column] < 0.0:
        x = guide.x + (column + 0.5) * guide.resolution
        y, best = guide.y + (row + 0.5) * guide.resolution, np.inf
        for k in range(len(guide.points)):
            across, up = x - guide.points[k, 0], y - guide.points[k, 1]
            best = min(best, guide.rest[k] + ASIDE * np.sqrt(across * across + up * up))
        guide.left[row, column] = best
    return guide.left[row, column]


@compiled
def find_way(
    ground: Ground,
    corners: FloatArray,
    reach: float,
    moves: Moves,
    cell: float,
    guide: Guide,
    surcharge: FloatArray,
    start: FloatArray,
    gear: int,
    braking: float,
    target: Target,
    most: int,
) -> tuple[NDArray[np.float64], int]:
    """A way from a pose to the target, [P, 4]: poses and the gear that leads to each.

    It is empty if none is found. Also returns how many poses were expanded.

    Args:
        corners: [K, 2] of the outline, with a margin; reach: m to the farthest.
        cell: m, within which poses of one heading count as one.
        surcharge: [H, W] >= 0 of the ground, m of detour that a metre is worth; or [0, 0].
        gear: in which the robot moves at the start, or STANDING.
        braking: m that it needs to stop at the start.
        most: poses to expand until a first way is found.
    """
    spans = np.empty((2, ground.room.shape[0]))
    size = min(MOST_NODES, (most + MUCH_FURTHER + 1) * (len(moves.gears) + 1))
    nodes = Nodes(
        np.empty((size, 3)),
        np.empty(size),
        np.empty(size),
        np.empty(size, np.int64),
        np.empty(size, np.int64),
        np.empty(size, np.int64),
    )
    places = LEAST_TABLE
    while places < 2 * size:
        places *= 2
    keys, held = np.full(places, EMPTY, np.int64), np.empty(places, np.int64)
    heap_cost, heap_node = np.empty(size), np.empty(size, np.int64)
    nodes.poses[0], nodes.costs[0], nodes.driven[0] = start, 0.0, 0.0
    nodes.parents[0], nodes.moves[0], nodes.gears[0] = -1, -1, gear
    key = _key(ground, cell, moves.bins, nodes, 0)
    place = _place(keys, key)
    keys[place], held[place] = key, 0
    count, waiting, expanded = 1, 1, 0
    heap_cost[0], heap_node[0] = 0.0, 0
    done = np.zeros(size, np.bool_)
    best, best_cost, best_node, enough = np.empty((0, 4)), np.inf, -1, most
    while (
        waiting
        and expanded < enough
        and heap_cost[0] < best_cost
        and count < size - len(moves.gears) - 1
    ):
        node = heap_node[0]
        waiting = _pop(heap_cost, heap_node, waiting)
        if done[node]:
            continue
        done[node] = True
        expanded += 1
        at = nodes.poses[node]
        away = np.hypot(at[0] - target.pose[0], at[1] - target.pose[1])
        if expanded % (SHOT_EVERY if away < NEAR else 8) == 1 or expanded <= 2:
            dearest = float(best_cost - nodes.costs[node])
            shot, cost = direct_way(
                ground, corners, reach, moves, at, int(nodes.gears[node]), target, dearest, spans
            )
            stays = nodes.driven[node] >= braking or (
                len(shot) > 0 and shot[0, 3] == nodes.gears[node]
            )
            stays &= _arrives(shot, at, target)
            if len(shot) and stays and nodes.costs[node] + cost < best_cost:
                long = nodes.costs[node] + cost > LONG * heap_cost[0]
                long &= moves.reverse and waiting > 0
                later = expanded + (MUCH_FURTHER if long else FURTHER)
                enough = later if best_node < 0 else min(enough, later)
                best, best_cost, best_node = shot, nodes.costs[node] + cost, node
        count, waiting = _expand(
            ground, corners, reach, moves, cell, guide, surcharge, braking, spans,
            nodes, node, count, keys, held, heap_cost, heap_node, waiting,
        )  # fmt: skip
    if best_node < 0:
        return best, expanded
    return _walked(nodes, best_node, moves, best), expanded


@compiled
def _arrives(shot: FloatArray, at: FloatArray, target: Target) -> bool:
    """Whether a shot [P, 4] from a pose ends in the target's gear, after a way long enough."""
    if target.gear == STANDING or not len(shot):
        return True
    return shot[-1, 3] == target.gear and (
        np.hypot(at[0] - target.pose[0], at[1] - target.pose[1]) >= target.braking
    )


@compiled
def _expand(
    ground: Ground,
    corners: FloatArray,
    reach: float,
    moves: Moves,
    cell: float,
    guide: Guide,
    surcharge: FloatArray,
    braking: float,
    spans: FloatArray,
    nodes: Nodes,
    node: int,
    count: int,
    keys: NDArray[np.int64],
    held: NDArray[np.int64],
    heap_cost: FloatArray,
    heap_node: NDArray[np.int64],
    waiting: int,
) -> tuple[int, int]:
    """Add the poses that short motions reach from a node; returns how many are known, and wait."""
    at, pose = nodes.poses[node], np.empty(3)
    turn = np.cos(at[2]), np.sin(at[2])
    for k in range(len(moves.gears)):
        changes = moves.gears[k] != nodes.gears[node]
        if changes and nodes.driven[node] < braking:
            continue
        _move(moves.poses[k, -1], at, turn, pose)
        if not _is_on(ground, pose):
            continue
        cost = moves.costs[k] + (moves.stop if changes else 0.0)
        if surcharge.size:
            cost += moves.lengths[k] * _at(surcharge, ground.x, ground.y, ground.resolution, pose)
        cost += nodes.costs[node]
        nodes.poses[count], nodes.costs[count] = pose, cost
        nodes.driven[count] = np.inf if changes else nodes.driven[node] + moves.lengths[k]
        nodes.parents[count], nodes.moves[count] = node, k
        nodes.gears[count] = moves.gears[k]
        key = _key(ground, cell, moves.bins, nodes, count)
        place = _place(keys, key)
        if keys[place] == key and nodes.costs[held[place]] <= cost + 1e-9:
            continue
        if not _is_free(ground, corners, reach, moves.poses[k], at, turn, pose, spans):
            continue
        keys[place], held[place] = key, count
        likely = cost + GREED * _left(guide, pose)
        waiting = _push(heap_cost, heap_node, waiting, likely, count)
        count += 1
    return count, waiting


@compiled
def _at(field: FloatArray, x: float, y: float, resolution: float, pose: FloatArray) -> float:
    """The value of a field [H, W] in the cell of a pose."""
    row = int((pose[1] - y) / resolution)
    column = int((pose[0] - x) / resolution)
    return field[min(max(row, 0), field.shape[0] - 1), min(max(column, 0), field.shape[1] - 1)]


@compiled
def _key(ground: Ground, cell: float, bins: int, nodes: Nodes, node: int) -> int:
    """The number of a pose's cell, heading and gear."""
    pose = nodes.poses[node]
    row = int(np.floor((pose[1] - ground.y) / cell))
    column = int(np.floor((pose[0] - ground.x) / cell))
    turn = int(np.floor(pose[2] / (2.0 * np.pi) * bins)) % bins
    # Who slides has no gear but this one and turns on the spot.
    return ((row * ROWS + column) * BINS + turn) * 4 + ((nodes.gears[node] + 1) & 3)


@compiled
def _place(keys: NDArray[np.int64], key: int) -> int:
    """The place of a key in a table whose size is a power of two, or the empty one for it."""
    last = len(keys) - 1
    place = ((key * 0x9E3779B97F4A7C1) >> 20) & last
    while keys[place] != EMPTY and keys[place] != key:
        place = (place + 1) & last
    return place


@compiled
def _push(costs: FloatArray, nodes: NDArray[np.int64], size: int, cost: float, node: int) -> int:
    """Add a node to the heap of `size`; returns its new size."""
    at = size
    while at and costs[(at - 1) // 2] > cost:
        costs[at], nodes[at] = costs[(at - 1) // 2], nodes[(at - 1) // 2]
        at = (at - 1) // 2
    costs[at], nodes[at] = cost, node
    return size + 1


@compiled
def _pop(costs: FloatArray, nodes: NDArray[np.int64], size: int) -> int:
    """Take the first node off the heap of `size`; returns its new size."""
    size -= 1
    cost, node, at = costs[size], nodes[size], 0
    while 2 * at + 1 < size:
        child = 2 * at + 1
        if child + 1 < size and costs[child + 1] < costs[child]:
            child += 1
        if costs[child] >= cost:
            break
        costs[at], nodes[at] = costs[child], nodes[child]
        at = child
    costs[at], nodes[at] = cost, node
    return size


@compiled
def _move(by: FloatArray, at: FloatArray, turn: tuple[float, float], pose: FloatArray) -> None:
    """Write the pose [3] that a motion [3] leads to; turn: cosine and sine of where it begins."""
    cosine, sine = turn
    pose[0] = at[0] + cosine * by[0] - sine * by[1]
    pose[1] = at[1] + sine * by[0] + cosine * by[1]
    pose[2] = at[2] + by[2]


@compiled
def _is_on(ground: Ground, pose: FloatArray) -> bool:
    """Whether a pose is on the map."""
    height, width = ground.room.shape
    u, v = (pose[0] - ground.x) / ground.resolution, (pose[1] - ground.y) / ground.resolution
    return 0.0 <= u < width and 0.0 <= v < height


@compiled
def _is_free(
    ground: Ground,
    corners: FloatArray,
    reach: float,
    poses: FloatArray,
    at: FloatArray,
    turn: tuple[float, float],
    pose: FloatArray,
    spans: FloatArray,
) -> bool:
    """Whether a short motion from `at` touches nothing; `pose` [3] becomes its end."""
    for look in range(len(poses)):
        _move(poses[look], at, turn, pose)
        if touches(ground, corners, reach, pose, spans):
            return False
    return True


@compiled
def _walked(nodes: Nodes, node: int, moves: Moves, shot: FloatArray) -> NDArray[np.float64]:
    """The way [P, 4] from the start to a node, and on by a shot."""
    looks, steps, at = moves.poses.shape[1], 0, node
    while nodes.parents[at] >= 0:
        steps, at = steps + 1, nodes.parents[at]
    way = np.empty((1 + steps * looks + len(shot), 4))
    way[0, :3], way[0, 3] = nodes.poses[at], nodes.gears[at]
    at = node
    for step in range(steps - 1, -1, -1):
        before, move = nodes.poses[nodes.parents[at]], nodes.moves[at]
        cosine, sine = np.cos(before[2]), np.sin(before[2])
        for look in range(looks):
            row, (x, y, turn) = 1 + step * looks + look, moves.poses[move, look]
            way[row, 0] = before[0] + cosine * x - sine * y
            way[row, 1] = before[1] + sine * x + cosine * y
            way[row, 2], way[row, 3] = before[2] + turn, moves.gears[move]
        at = nodes.parents[at]
    way[1 + steps * looks :] = shot
    return way
