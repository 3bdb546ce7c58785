"""Worlds of people: what a driver may know of them now, and how they move on. Recordings are one.

Recordings follow Mizuta and Leung (CFM-MPPI, ICRA 2026): one person is taken out, the robot starts
at rest in their place and is due where they were at the end; the others do not see the robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.scene_files import read_arrays, spread_evenly

Array = NDArray[np.float64]

TICK_S = 0.1  # between two decisions
RADIUS = 0.25  # m, of the robot and of each person
CONTACT = 2 * RADIUS  # m between centres; less is a collision
TOLERANCE = 0.5  # m from the goal
MAP_CELLS, MAP_RESOLUTION = 128, 0.15  # 9.6 m to every side of the robot


@dataclass(frozen=True, eq=False)
class Grid:
    """occupied: [H, W]; resolution: m/cell; origin: [2] m, the corner of cell (0, 0)."""

    occupied: NDArray[np.bool_]
    resolution: float
    origin: Array

    @property
    def centres(self) -> Array:
        """[H, W, 2] m."""
        rows, columns = np.indices(self.occupied.shape)
        return self.origin + self.resolution * (np.stack([columns, rows], -1) + 0.5)


class World:
    """People who walk, and the robot's way among them; open ground unless a subclass has walls.

    kind, name: of the tables that count it; seed: of drivers' noise; ticks: of the longest run
    start, goal: [2] m; positions, velocities: [M, 2] of the people now, NaN while absent
    left_s: until the robot is due at the goal; None if a run ends when it arrives
    reach: m to the farthest goal of a request
    """

    kind: str
    name: str
    seed: int
    ticks: int
    start: Array
    goal: Array
    positions: Array
    velocities: Array
    left_s: float | None = None
    reach: float = 9.0

    def begin(self) -> None:
        """Put the people where they are at the start."""
        raise NotImplementedError

    def advance(self, state: Array) -> None:
        """Let the people walk for TICK_S, in which the robot gets to a state [6]."""
        raise NotImplementedError

    @property
    def present(self) -> NDArray[np.bool_]:
        """[M]."""
        return ~np.isnan(self.positions[:, 0])

    def map_around(self, position: Array) -> Grid:
        """Return the map that a robot at [2] has."""
        corner = position - 0.5 * MAP_CELLS * MAP_RESOLUTION
        return Grid(np.zeros((MAP_CELLS, MAP_CELLS), bool), MAP_RESOLUTION, corner)

    def way_to_goal(self, points: Array) -> Array:
        """Return the m from points [..., 2] to the goal."""
        return np.linalg.norm(points - self.goal, axis=-1)

    def wall_distance(self, points: Array) -> Array:
        """Return the m from points [..., 2] to the nearest wall."""
        return np.full(points.shape[:-1], np.inf)


@dataclass(eq=False)
class Recording(World):
    """A window of `others` [M, T + 1, 2] m at every TICK_S, NaN while absent."""

    name: str
    seed: int
    start: Array
    goal: Array
    others: Array
    kind = "recorded people"

    def begin(self) -> None:
        self.tick, self.ticks = -1, self.others.shape[1] - 1
        self.advance(self.start)

    def advance(self, state: Array) -> None:  # noqa: ARG002 the people do not see the robot
        """Velocities are those of the last tick, 0 if unknown."""
        self.tick += 1
        last = max(self.tick - 1, 0)
        velocities = (self.others[:, last + 1] - self.others[:, last]) / TICK_S
        self.positions, self.velocities = self.others[:, self.tick], np.nan_to_num(velocities)
        self.left_s = (self.ticks - self.tick) * TICK_S


def read_recordings(folder: Path, *, limit: int | None = None) -> list[Recording]:
    """Read the windows of a .npz file or of all in a folder, at most `limit` of each.

    The keys of a file: ego [W, T + 1, 2] m, the person that the robot replaces; others
    [M, T + 1, 2] m, NaN while absent, of which each window owns the next of count [W].

    Raises `BenchmarkError` if there is no file, or one cannot be read.
    """
    files = sorted(folder.glob("*.npz")) if folder.is_dir() else [folder]
    if not files:
        raise BenchmarkError(f"{folder}: expected .npz files of recorded people, found none")
    return [window for file in files for window in spread_evenly(_windows(file), limit)]


def _windows(file: Path) -> list[Recording]:
    ego, others, count = read_arrays(file, ("ego", "others", "count"), what="people").values()
    if len(ego) != len(count) or count.sum() != len(others) or ego.shape[1:] != others.shape[1:]:
        raise BenchmarkError(f"{file}: not a file of people (its counts do not add up)")
    split = np.split(others.astype(np.float64), np.cumsum(count)[:-1])
    return [
        Recording(file.stem, index, way[0], way[-1], people)
        for index, (way, people) in enumerate(zip(ego.astype(np.float64), split, strict=True))
    ]
