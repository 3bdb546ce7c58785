"""The surroundings as compiled loops look them up: walls, soft costs, moving discs.

Compiled loops have the robot's place as their origin, so that float32 is exact wherever the map
lies. Beyond the map, fields are as on its edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import CostMap, Obstacles
from anchorflow_client.errors import InvalidRequest
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.cost.clearance import OCCUPIED, SHARED, signed_distance
from anchorflow_trajectory.cost.fields import soft_cost

Floats = NDArray[np.float32]

FAR = np.float32(1e3)  # m, the distance to obstacles of a map without any
NONE, HALF = np.float32(0.0), np.float32(0.5)


class Grid(NamedTuple):
    """A field on cell centres [H,W]; first_x, first_y: of cell (0, 0), in cells from the origin.

    A field of no cells is 0 everywhere.
    """

    values: Floats
    cells_per_m: np.float32
    first_x: np.float32
    first_y: np.float32


class Movers(NamedTuple):
    """Discs that move: places [T,M,2] and radii [T,M] in m, at the ends of T steps.

    counts: [T], of those that the robot may come near by then; they stand first
    """

    places: Floats
    radii: Floats
    counts: NDArray[np.int64]


class Surroundings(NamedTuple):
    """distance: m to obstacles, negative inside; surcharge: m of detour worth a metre of way."""

    distance: Grid
    surcharge: Grid
    movers: Movers


class MapFields:
    """The fields of a cost map: m to obstacles, and m of detour that a metre of way is worth."""

    def __init__(self, cost_map: CostMap, cost_penalty: float) -> None:
        """Compute them. Raises `InvalidRequest` for a map [B,C,H,W]."""
        if cost_map.data.ndim != 3:
            came = list(cost_map.data.shape)
            raise InvalidRequest(f"expected shape [C,H,W], got {came}", "cost_map.data")
        self.cost_map = cost_map
        occupied = np.asarray(cost_map.occupancy >= OCCUPIED)
        distance = SHARED.of(occupied, cost_map.resolution, signed_distance)
        self.distance = np.minimum(distance, FAR)
        soft = soft_cost(cost_map.data, cost_map.channel_weights)
        soft *= np.float32(cost_penalty)
        self.surcharge = soft if soft.any() else np.zeros((0, 0), np.float32)

    def grid(self, values: Floats, place: NDArray[np.float64]) -> Grid:
        """Return the grid of a field as seen from a place [2] in m."""
        first = (self.cost_map.origin - place) / self.cost_map.resolution + 0.5
        return Grid(values, np.float32(1.0 / self.cost_map.resolution), *map(np.float32, first))

    def around(self, place: NDArray[np.float64], movers: Movers) -> Surroundings:
        """Return the surroundings as seen from a place [2] in m, as the movers are already."""
        return Surroundings(
            self.grid(self.distance, place), self.grid(self.surcharge, place), movers
        )


def movers_at(
    obstacles: Obstacles | None,
    place: NDArray[np.float64],
    times: NDArray[np.float64],
    *,
    near: NDArray[np.float64],
) -> Movers:
    """Return obstacles at times [T] s, as seen from a place [2] in m.

    near: [T] m from the place to a disc's rim, beyond which a disc does not count at that time
    """
    if obstacles is None or not len(obstacles.radius):
        shape = (len(times), 0)
        nobody, nowhere = np.zeros(shape, np.float32), np.zeros((*shape, 2), np.float32)
        return Movers(nowhere, nobody, np.zeros(len(times), np.int64))
    places = (obstacles.places(times) - place).transpose(1, 0, 2)
    radii = obstacles.radius + obstacles.growth * times[:, None]
    is_near = np.linalg.norm(places, axis=-1) - radii < near[:, None]
    order = np.argsort(~is_near, axis=1, kind="stable")
    return Movers(
        np.take_along_axis(places, order[..., None], axis=1).astype(np.float32),
        np.take_along_axis(radii, order, axis=1).astype(np.float32),
        is_near.sum(1),
    )


@compiled
def value_at(grid: Grid, x: np.float32, y: np.float32) -> np.float32:
    """Return the field at a point in m, bilinear between cell centres."""
    height, width = grid.values.shape
    if not height:
        return NONE
    u = min(max(x * grid.cells_per_m - grid.first_x, NONE), np.float32(width - 1))
    v = min(max(y * grid.cells_per_m - grid.first_y, NONE), np.float32(height - 1))
    column, row = min(int(u), width - 2), min(int(v), height - 2)
    share_u, share_v = u - np.float32(column), v - np.float32(row)
    near, right = grid.values[row, column], grid.values[row, column + 1]
    up, far = grid.values[row + 1, column], grid.values[row + 1, column + 1]
    low = near + share_u * (right - near)
    return low + share_v * (up + share_u * (far - up) - low)


@compiled
def reach_of(discs: Floats) -> np.float32:
    """Return m from the robot's place to the farthest point of a body of discs [J,3]."""
    reach = NONE
    for j in range(len(discs)):
        out = np.sqrt(discs[j, 0] * discs[j, 0] + discs[j, 1] * discs[j, 1])
        reach = max(reach, out + discs[j, 2])
    return reach


@compiled
def clear_of_obstacles(
    distance: Grid, discs: Floats, enough: np.float32, states: Floats, rooms: Floats
) -> None:
    """Write m [K,T] between a body of discs [J,3] in states [K,T,5] and obstacles.

    distance: m to obstacles; enough: m, below which the result is exact, and else a lower bound
    """
    reach = reach_of(discs)
    for k in range(len(states)):
        for t in range(states.shape[1]):
            x, y, heading = states[k, t, 0], states[k, t, 1], states[k, t, 2]
            room = value_at(distance, x, y) - reach
            # Not even the farthest point of the body is near, or there is one disc.
            if room <= enough and len(discs) > 1:
                cos, sin, room = np.cos(heading), np.sin(heading), FAR
                for j in range(len(discs)):
                    at_x = x + cos * discs[j, 0] - sin * discs[j, 1]
                    at_y = y + sin * discs[j, 0] + cos * discs[j, 1]
                    room = min(room, value_at(distance, at_x, at_y) - discs[j, 2])
            rooms[k, t] = room


@compiled
def clear_of_movers(
    places: Floats,
    radii: Floats,
    counts: NDArray[np.int64],
    discs: Floats,
    states: Floats,
    rooms: Floats,
) -> None:
    """Lower m [K,T] to those between a body of discs [J,3] in states [K,T,5] and moving discs.

    places, radii, counts: of `Movers`
    """
    reach = reach_of(discs)
    for k in range(len(states)):
        for t in range(states.shape[1]):
            x, y, heading, room = states[k, t, 0], states[k, t, 1], states[k, t, 2], rooms[k, t]
            for m in range(counts[t]):
                by_x, by_y = places[t, m, 0] - x, places[t, m, 1] - y
                far = radii[t, m] + reach + room
                if far <= NONE or by_x * by_x + by_y * by_y >= far * far:
                    continue
                cos, sin = np.cos(heading), np.sin(heading)
                ahead, left = cos * by_x + sin * by_y, cos * by_y - sin * by_x
                for j in range(len(discs)):
                    by_x, by_y = ahead - discs[j, 0], left - discs[j, 1]
                    apart = np.sqrt(by_x * by_x + by_y * by_y)
                    room = min(room, apart - radii[t, m] - discs[j, 2])
            rooms[k, t] = room
