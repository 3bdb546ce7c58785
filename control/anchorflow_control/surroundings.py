"""What is round the robot, as compiled loops look it up: walls, soft costs, what moves.

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

FAR = 1e3  # m, the distance to obstacles of a map without any
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
    """Discs that move: places [T,M,2] and radii [T,M] in m, at the ends of T steps."""

    places: Floats
    radii: Floats


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
        self.distance = np.minimum(distance, np.float32(FAR))
        soft = soft_cost(cost_map.data, cost_map.channel_weights)
        soft *= np.float32(cost_penalty)
        self.surcharge = soft if soft.any() else np.zeros((0, 0), np.float32)

    def grid(self, values: Floats, place: NDArray[np.float64]) -> Grid:
        """Return the grid of a field as seen from a place [2] in m."""
        first = (self.cost_map.origin - place) / self.cost_map.resolution + 0.5
        return Grid(values, np.float32(1.0 / self.cost_map.resolution), *map(np.float32, first))

    def around(
        self, place: NDArray[np.float64], obstacles: Obstacles | None, times: NDArray[np.float64]
    ) -> Surroundings:
        """Return what is round a place [2] in m; obstacles are moved to times [T] s."""
        return Surroundings(
            self.grid(self.distance, place),
            self.grid(self.surcharge, place),
            movers_at(obstacles, place, times),
        )


def movers_at(
    obstacles: Obstacles | None, place: NDArray[np.float64], times: NDArray[np.float64]
) -> Movers:
    """Return the places and radii of obstacles at times [T] s, as seen from a place [2] in m."""
    if obstacles is None or not len(obstacles.radius):
        return Movers(
            np.zeros((len(times), 0, 2), np.float32), np.zeros((len(times), 0), np.float32)
        )
    places = (obstacles.places(times) - place).transpose(1, 0, 2)
    radii = obstacles.radius + obstacles.growth * times[:, None]
    return Movers(np.ascontiguousarray(places, np.float32), radii.astype(np.float32))


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
def nearest_mover(
    movers: Movers, t: int, x: np.float32, y: np.float32, most: np.float32
) -> np.float32:
    """Return m from a point to the rim of the nearest disc at the end of step t, at most `most`."""
    least = most
    for j in range(movers.radii.shape[1]):
        across, along = x - movers.places[t, j, 0], y - movers.places[t, j, 1]
        far = movers.radii[t, j] + least
        square = across * across + along * along
        if far > NONE and square < far * far:
            least = np.sqrt(square) - movers.radii[t, j]
    return least


@compiled
def body_clearance(
    around: Surroundings,
    discs: Floats,
    t: int,
    pose: tuple[np.float32, np.float32, np.float32],
    enough: np.float32,
) -> np.float32:
    """Return m between the body and what is nearest at the end of step t, exact below `enough`.

    discs: [J,3], the body's; a negative t: without what moves
    """
    x, y, heading = pose
    if len(discs) == 1:
        radius = discs[0, 2]
        room = value_at(around.distance, x, y) - radius
        if t >= 0 and around.movers.radii.shape[1]:
            room = min(room, nearest_mover(around.movers, t, x, y, enough + radius) - radius)
        return room
    cos, sin, least = np.cos(heading), np.sin(heading), np.float32(FAR)
    for j in range(len(discs)):
        at_x = x + cos * discs[j, 0] - sin * discs[j, 1]
        at_y = y + sin * discs[j, 0] + cos * discs[j, 1]
        least = min(least, value_at(around.distance, at_x, at_y) - discs[j, 2])
        if t >= 0 and around.movers.radii.shape[1]:
            most = enough + discs[j, 2]
            room = nearest_mover(around.movers, t, at_x, at_y, most) - discs[j, 2]
            least = min(least, room)
    return least
