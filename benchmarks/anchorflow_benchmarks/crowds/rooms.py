"""Drawn rooms with people who avoid each other, the walls and the robot.

The people are agents of the RVO2 library (Van den Berg et al., "Reciprocal n-Body Collision
Avoidance", 2011) by its package `pyrvo`, and walk from place to place along the shortest way.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pyrvo
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates

from anchorflow_benchmarks.crowds.worlds import CONTACT, RADIUS, TICK_S, Array, Grid, World
from anchorflow_benchmarks.grid_path import distances_from
from anchorflow_training.scene_layouts import Canvas, rooms
from anchorflow_trajectory.cost.clearance import distance_to_cells

CELLS, CELL = 120, 0.1  # cells of a side; m
WIDE = 0.5  # m, radius of the robot that doors are drawn for: two of RADIUS pass each other
PASSAGE = RADIUS + 0.15  # m to the walls along the shortest ways
MIN_WAY = 8.0  # m from the robot's start to its goal
TIME_LIMIT_S = 40.0
PLACES, PEOPLE = 8, (4, 13)  # places that people walk to; people, least and one above the most
SPEEDS, PAUSE_S, PAUSE_SHARE = (0.8, 1.6), 4.0, 0.4  # m/s; at a place, at most; of the arrivals
COMFORT, HORIZONS_S = 0.05, (1.0, 3.0)  # of ORCA: m beyond the radius, and s to a collision
AWAY = 1.5  # m from the robot to people at the start
LOOK_AHEAD = 0.5  # m along the way to a place
BLOCKED = 1e3  # m to a place from within PASSAGE of a wall


@dataclass(frozen=True, eq=False)
class Layout:
    """grid: the walls; distance: [H, W] m to them; places: [P, 2] m; ways: [P, H, W] m to each.

    The robot drives from the first place to the second; to_goal: [H, W] m, near walls too.
    """

    grid: Grid
    distance: Array
    places: Array
    ways: Array
    to_goal: Array

    def sample(self, field: Array, points: Array) -> Array:
        """Interpolate a field [H, W] at points [..., 2]."""
        columns, rows = (points.reshape(-1, 2) / CELL - 0.5).T
        values = map_coordinates(field, [rows, columns], order=1, mode="nearest")
        return values.reshape(points.shape[:-1])


def draw_layout(seed: int) -> Layout:
    """Draw rooms and places that are joined by ways of PASSAGE."""
    rng = np.random.default_rng(seed)
    while True:
        occupied = rooms(Canvas(rng, CELLS, CELL, WIDE))
        occupied[[0, -1]] = occupied[:, [0, -1]] = True
        distance = distance_to_cells(occupied, CELL).astype(np.float64)
        passable = distance > PASSAGE
        cells = rng.permutation(np.argwhere(passable))[:PLACES]
        lengths = [distances_from(passable, (int(row), int(column))) for row, column in cells]
        ways = np.nan_to_num(CELL * np.stack(lengths), posinf=BLOCKED)
        joined = ways[0, cells[:, 0], cells[:, 1]]
        if joined[1] > MIN_WAY and joined.max() < BLOCKED:
            row, column = np.asarray(
                distance_transform_edt(~passable, return_distances=False, return_indices=True)
            )
            to_goal = ways[1, row, column] + np.maximum(PASSAGE - distance, 0.0)
            grid, places = Grid(occupied, CELL, np.zeros(2)), CELL * (cells[:, ::-1] + 0.5)
            return Layout(grid, distance, places, ways, to_goal)


def rectangles(occupied: NDArray[np.bool_]) -> Iterator[tuple[int, int, int, int]]:
    """Cover occupied cells by rectangles: first column, first row, and those after the last."""
    began: dict[tuple[int, int], int] = {}
    for row, cells in enumerate([*occupied, np.zeros(occupied.shape[1], bool)]):
        edges = np.flatnonzero(np.diff(np.pad(cells, 1).astype(int)))
        runs = [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]
        for first, end in began.keys() - runs:
            yield first, began.pop((first, end)), end, row
        began = dict.fromkeys(runs, row) | began


class Room(World):
    """A run in a layout, with the robot as an agent whose motion is given; `seed` draws people."""

    kind = name = "rooms"
    reach = np.inf
    ticks = round(TIME_LIMIT_S / TICK_S)

    def __init__(self, layout: Layout, *, seed: int) -> None:
        self.layout, self.seed = layout, seed
        self.start, self.goal = layout.places[:2]

    def begin(self) -> None:
        self._rng = rng = np.random.default_rng([self.seed, 1])
        self._simulator = pyrvo.RVOSimulator()  # pyright: ignore[reportAttributeAccessIssue]
        self._simulator.set_time_step(TICK_S)
        for cells in rectangles(self.layout.grid.occupied):
            x0, y0, x1, y1 = (CELL * index for index in cells)
            self._simulator.add_obstacle([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        self._simulator.process_obstacles()
        free = CELL * (np.argwhere(self.layout.ways[0] < BLOCKED)[:, ::-1] + 0.5)
        free = free[np.linalg.norm(free - self.start, axis=1) > AWAY]
        count = int(rng.integers(*PEOPLE))
        self.positions = rng.permutation(free)[:count]  # who overlaps moves apart at once
        self.velocities = np.zeros_like(self.positions)
        self._speeds, self._pauses = rng.uniform(*SPEEDS, count), np.zeros(count)
        self._targets = rng.integers(PLACES, size=count)
        for position in [*self.positions, self.start]:
            horizon_s, neighbours_within, neighbours = rng.uniform(*HORIZONS_S), 5.0, 8
            self._simulator.add_agent(
                tuple(position.tolist()),
                neighbours_within,
                neighbours,
                horizon_s,
                HORIZONS_S[0],  # to walls
                RADIUS + COMFORT,
                1.25 * SPEEDS[1],
            )

    def advance(self, state: Array) -> None:
        simulator, robot = self._simulator, len(self.positions)
        moves = [*self._preferred(), state[2:4]]
        for agent, velocity in enumerate(moves):
            simulator.set_agent_pref_velocity(agent, tuple(velocity.tolist()))
        simulator.set_agent_velocity(robot, tuple(state[2:4].tolist()))
        simulator.do_step()
        simulator.set_agent_position(robot, tuple(state[:2].tolist()))
        for person in range(robot):
            place, velocity = (
                read(person)
                for read in (simulator.get_agent_position, simulator.get_agent_velocity)
            )
            self.positions[person] = place.x, place.y
            self.velocities[person] = velocity.x, velocity.y

    def _preferred(self) -> Array:
        """Return each one's velocity [M, 2] along the way; draw new places and pauses."""
        angles = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
        ring = np.stack([np.cos(angles), np.sin(angles)], -1)
        velocities = self._rng.normal(0.0, 0.1, self.positions.shape)
        self._pauses -= TICK_S
        for person in np.flatnonzero(self._pauses <= 0.0):
            position, target = self.positions[person], self._targets[person]
            if np.hypot(*(self.layout.places[target] - position)) < CONTACT:
                self._targets[person] = self._rng.integers(PLACES)
                self._pauses[person] = self._rng.uniform(0.0, PAUSE_S)
                self._pauses[person] *= self._rng.random() < PAUSE_SHARE
            ways = self.layout.sample(self.layout.ways[target], position + LOOK_AHEAD * ring)
            velocities[person] += self._speeds[person] * ring[ways.argmin()]
        return velocities

    def map_around(self, position: Array) -> Grid:  # noqa: ARG002 it has the whole map
        return self.layout.grid

    def way_to_goal(self, points: Array) -> Array:
        return self.layout.sample(self.layout.to_goal, points)

    def wall_distance(self, points: Array) -> Array:
        return self.layout.sample(self.layout.distance, points)
