"""Worlds: a start, a goal and round posts in between, as in the BARN challenge.

BARN: Perille, Truong, Xiao and Stone, "Benchmarking Metric Ground Navigation" (SSRR 2020).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.array_files import read_arrays
from anchorflow_benchmarks.closed_loop.widest_way import widest_way
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.grid_path import shortest_grid_path
from anchorflow_trajectory.clearance import distance_to_cells

Array = NDArray[np.float64]

DRAWN = "drawn"
GOAL_TOLERANCE = 1.0  # m; the challenge counts a robot as arrived from there

# Drawn worlds: BARN's corridor and its grid of posts.
SPACING, RADIUS, WIDTH, LENGTH = 0.15, 0.075, 4.5, 9.6  # m
START, GOAL = (-2.25, 3.0, np.pi / 2), (-2.25, 13.0)
FIRST_ROW = 5.1  # m along y, from which on posts stand in the corridor
ROBOT_RADIUS = 0.25  # m, of the robots for which worlds are drawn
LEAST_GAP = 0.08  # m to spare on either side at the narrowest place of a drawn world's widest way
PASSAGE = 0.3  # m, the robot's radius and a little more, that a scene of a file has to leave open


@dataclass(frozen=True, eq=False)
class World:
    """posts: [M, 2] m, their centres; start: [3] x, y in m, yaw in rad; goal: [2] m.

    path_length: m of the shortest way that fits the robot
    """

    name: str
    posts: Array
    post_radius: float
    start: Array
    goal: Array
    path_length: float

    def clearance(self, position: Array, robot_radius: float) -> float:
        """m between a robot at [2] and the nearest post; negative where they overlap."""
        nearest = np.sqrt(((self.posts - position) ** 2).sum(1).min(initial=np.inf))
        return float(nearest) - self.post_radius - robot_radius

    @cached_property
    def to_spare(self) -> float:
        """m that a robot of ROBOT_RADIUS has on either side where its widest way is narrowest."""
        ends = self.start[:2], self.goal
        return widest_way(self.posts, self.post_radius, *ends) - ROBOT_RADIUS


def read_worlds(path: Path) -> list[World]:
    """The worlds of a .npz file.

    Its keys: cylinders [M, 2] m, of which world k owns rows offsets[k] to offsets[k + 1]; radius m
    of a cylinder; start x, y, yaw; goal x, y; path_length [K] m; world [K], their numbers.

    Raises:
        BenchmarkError: the file cannot be read or lacks a key.
    """
    keys = ("cylinders", "offsets", "radius", "start", "goal", "path_length", "world")
    read = read_arrays(path, keys, what="worlds")
    try:
        arrays = {name: array.astype(np.float64) for name, array in read.items()}
        posts = np.split(arrays["cylinders"], arrays["offsets"].astype(int)[1:-1])
        radius, start, goal = float(arrays["radius"]), arrays["start"], arrays["goal"]
        rows = zip(arrays["world"], posts, arrays["path_length"], strict=True)
        return [
            World(f"BARN {int(number)}", centres, radius, start, goal, float(length))
            for number, centres, length in rows
        ]
    except (ValueError, TypeError) as error:
        raise BenchmarkError(f"{path}: not a file of worlds ({error})") from error


def draw_world(seed: int, *, least_gap: float = LEAST_GAP) -> World:
    """A corridor like BARN's with clusters of posts at random; there is a way through.

    least_gap: m that its widest way leaves a robot of ROBOT_RADIUS to spare on either side
    """
    rng = np.random.default_rng(seed)
    start, goal = np.array(START), np.array(GOAL)
    while True:
        posts = np.concatenate([_walls(), _clusters(rng, share=rng.uniform(0.08, 0.2))])
        length = _shortest_way(posts, passage=ROBOT_RADIUS + least_gap)
        if np.isfinite(length):
            world = World(f"{DRAWN} {seed}", posts, RADIUS, start, goal, length)
            if world.to_spare >= least_gap:
                return world


def _walls() -> Array:
    """Posts along both sides and the near end of the corridor."""
    y = np.arange(0.0, LENGTH, SPACING)
    x = np.arange(-WIDTH + SPACING, -SPACING / 2, SPACING)
    left, right = (np.stack([np.full_like(y, side), y], 1) for side in (-WIDTH, 0.0))
    return np.concatenate([left, right, np.stack([x, np.zeros_like(x)], 1)])


def _clusters(rng: np.random.Generator, share: float) -> Array:
    """Posts on the grid's cells; smoothed noise makes them stand together."""
    x = np.arange(-WIDTH + SPACING, -SPACING / 2, SPACING)
    y = np.arange(FIRST_ROW, LENGTH, SPACING)
    noise = np.pad(rng.normal(size=(len(y), len(x))), 1, mode="edge")
    smooth = sum(noise[i : i + len(y), j : j + len(x)] for i in range(3) for j in range(3))
    rows, columns = np.nonzero(smooth > np.quantile(smooth, 1.0 - share))
    return np.stack([x[columns], y[rows]], 1)


def _shortest_way(posts: Array, *, passage: float) -> float:
    """m from START to GOAL for a robot of a radius in m; NaN where there is no way."""
    cell = 0.05
    low = np.array([-WIDTH - 1.0, -1.0])
    width, height = np.ceil((np.array([1.0, GOAL[1] + 1.0]) - low) / cell).astype(int)
    columns, rows = np.floor((posts - low) / cell).astype(int).T
    occupied = np.zeros((height, width), bool)
    occupied[rows, columns] = True
    passable = distance_to_cells(occupied, cell) > passage + RADIUS - cell / 2
    ends = [np.floor((np.array(point[:2]) - low) / cell).astype(int) for point in (START, GOAL)]
    start, goal = ((int(y), int(x)) for x, y in ends)
    return cell * shortest_grid_path(passable, start, goal)
