"""Worlds: a start, a goal and round posts in between, as in the BARN challenge.

BARN: Perille, Truong, Xiao and Stone, "Benchmarking Metric Ground Navigation" (SSRR 2020).

They are read from files of worlds or scenes, or drawn: corridors like BARN's, which have one
or two ways through, and forests, which have a choice of several.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, label
from scipy.spatial import KDTree

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.grid_path import grid_path, shortest_way
from anchorflow_benchmarks.scene_files import (
    count_and_seed,
    held_out_scenes,
    read_arrays,
    read_scenes,
    spread_evenly,
)
from anchorflow_driving.errors import UNREADABLE
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost.clearance import distance_to_cells
from anchorflow_trajectory.motion import MotionLimits

Array = NDArray[np.float64]

DRAWN, FORESTS, NARROW = "drawn", "forests", "narrow"
GOAL_TOLERANCE = 1.0  # m; the challenge counts a robot within it as arrived
ROBOT_RADIUS = 0.25  # m, of the robots that worlds are drawn for
MIN_GAP = 0.08  # m to spare on either side at the narrowest place of the widest way
MAX_GAP = 0.25  # m that drawing finds in reasonable time
NARROW_GAPS = (0.04, 0.08)  # m to spare: for a Jackal's rectangle, not for the disc round it
EIGHT_NEIGHBOURS = np.ones((3, 3), bool)

# Drawn corridors: BARN's, with its grid of posts.
SPACING, RADIUS, WIDTH, LENGTH = 0.15, 0.075, 4.5, 9.6  # m
START, GOAL = (-2.25, 3.0, np.pi / 2), (-2.25, 13.0)
FIRST_ROW = 5.1  # m along y, of the first posts in the corridor

# Forests: blocks and discs on open ground.
FAMILIES = ("forest", "discs")
SIDES = (9.0, 16.0)  # m
MIN_WAY = 6.0  # m; GOAL_TOLERANCE would be more than a fifth of a shorter one
LIMITS = MotionLimits(v_max=2.0, a_max=3.0)  # of the robots
PASSAGE = 0.3  # m, the robot's radius and a little more, that a scene has to leave open

# The search for the widest way.
CELL = 0.03  # m; the result is at most half a cell's diagonal too small
MARGIN = 1.5  # m of free space round posts and ends
HALVINGS = 12


@dataclass(frozen=True, eq=False)
class World:
    """posts: [M, 2] m, centres; start: [3] x, y in m, yaw in rad; goal: [2] m.

    path_length: m of the shortest way that fits the robot
    """

    name: str
    posts: Array
    post_radius: float
    start: Array
    goal: Array
    path_length: float

    def clearance(self, position: Array, robot_radius: float) -> float:
        """Return the m between a robot at [2] and the nearest post; negative if they overlap."""
        nearest = np.sqrt(((self.posts - position) ** 2).sum(1).min(initial=np.inf))
        return float(nearest) - self.post_radius - robot_radius

    def rectangle_clearance(self, pose: Array, half: tuple[float, float]) -> float:
        """Return the m between a rectangle at a pose [3] and the nearest post; as `clearance`.

        half: m, half the length along the heading and half the width
        """
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        off = np.abs((self.posts - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])) - half
        apart = np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(off.max(1), 0.0)
        return float(apart.min(initial=np.inf)) - self.post_radius

    @cached_property
    def to_spare(self) -> float:
        """m on either side of a robot of ROBOT_RADIUS at the narrowest place of its widest way."""
        ends = self.start[:2], self.goal
        return widest_way(self.posts, self.post_radius, *ends) - ROBOT_RADIUS


def read_worlds(path: Path) -> list[World]:
    """Read the worlds of a .npz file.

    Its keys: cylinders [M, 2] m, of which world k owns rows offsets[k] to offsets[k + 1]; radius m
    of a cylinder; start x, y, yaw; goal x, y; path_length [K] m; world [K], their numbers.

    Raises `BenchmarkError` if the file cannot be read or lacks a key.
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


def load_worlds(source: str, *, limit: int | None = None) -> list[World]:
    """Load the worlds of a .npz file, `drawn:COUNT:SEED`, `narrow:…` or `forests:…`.

    Narrow ones are drawn for a Jackal's rectangle; the disc round it does not fit through.

    `:GAP` after the seed replaces MIN_GAP: `drawn:20:0:0.12`. A file holds worlds, or scenes in the
    format of `scene_files`. At most `limit` worlds are returned, evenly spread.

    Raises `BenchmarkError` if the file holds neither, or a scene that the robot cannot cross, or
    the text has another form.
    """
    kind, _, rest = source.partition(":")
    if kind == DRAWN:
        count, seed, gap = _drawing(kind, rest)
        worlds = [draw_world(1000 * seed + index, min_gap=gap) for index in range(count)]
    elif kind == NARROW:
        count, seed = count_and_seed(rest, kind)
        low, high = NARROW_GAPS
        worlds = [draw_world(1000 * seed + i, min_gap=low, max_gap=high) for i in range(count)]
    elif kind == FORESTS:
        count, seed, gap = _drawing(kind, rest)
        worlds = draw_forests(count, seed, min_gap=gap)
    elif _holds_scenes(path := Path(source)):
        scenes = enumerate(read_scenes(path, limits=LIMITS))
        worlds = [world_of_scene(scene, f"{scene.family} {index}") for index, scene in scenes]
    else:
        worlds = read_worlds(path)
    return spread_evenly(worlds, limit)


def _drawing(kind: str, text: str) -> tuple[int, int, float]:
    """Parse `COUNT:SEED` or `COUNT:SEED:GAP`, the gap in m."""
    drawn, _, gap = text.rpartition(":") if text.count(":") == 2 else (text, "", MIN_GAP)
    count, seed = count_and_seed(drawn, kind)
    try:
        least = float(gap)
    except ValueError:
        least = np.nan
    if not 0.0 <= least <= MAX_GAP:
        raise BenchmarkError(f"expected a GAP from 0 to {MAX_GAP} m, got {kind}:{text}")
    return count, seed, least


def _holds_scenes(path: Path) -> bool:
    """Check for a .npz file with maps; `read_worlds` reports files that are none."""
    try:
        with np.load(path) as file:
            return "occupancy" in file.files
    except (*UNREADABLE, TypeError, AttributeError):
        return False


def draw_world(seed: int, *, min_gap: float = MIN_GAP, max_gap: float = np.inf) -> World:
    """Draw a corridor like BARN's with random clusters of posts and a way through.

    min_gap, max_gap: m to spare on either side of a robot of ROBOT_RADIUS on the widest way
    """
    rng = np.random.default_rng(seed)
    start, goal = np.array(START), np.array(GOAL)
    while True:
        posts = np.concatenate([_walls(), _clusters(rng, share=rng.uniform(0.08, 0.2))])
        length = _shortest_way(posts, passage=ROBOT_RADIUS + min_gap)
        if np.isfinite(length):
            world = World(f"{DRAWN} {seed}", posts, RADIUS, start, goal, length)
            if min_gap <= world.to_spare <= max_gap:
                return world


def _walls() -> Array:
    """Return posts along both sides and the near end of the corridor."""
    y = np.arange(0.0, LENGTH, SPACING)
    x = np.arange(-WIDTH + SPACING, -SPACING / 2, SPACING)
    left, right = (np.stack([np.full_like(y, side), y], 1) for side in (-WIDTH, 0.0))
    return np.concatenate([left, right, np.stack([x, np.zeros_like(x)], 1)])


def _clusters(rng: np.random.Generator, share: float) -> Array:
    """Draw posts on grid cells; smoothed noise clusters them."""
    x = np.arange(-WIDTH + SPACING, -SPACING / 2, SPACING)
    y = np.arange(FIRST_ROW, LENGTH, SPACING)
    noise = np.pad(rng.normal(size=(len(y), len(x))), 1, mode="edge")
    smooth = sum(noise[i : i + len(y), j : j + len(x)] for i in range(3) for j in range(3))
    rows, columns = np.nonzero(smooth > np.quantile(smooth, 1.0 - share))
    return np.stack([x[columns], y[rows]], 1)


def _shortest_way(posts: Array, *, passage: float) -> float:
    """Return the m from START to GOAL for a robot of a radius in m; NaN without a way."""
    cell = 0.05
    low = np.array([-WIDTH - 1.0, -1.0])
    width, height = np.ceil((np.array([1.0, GOAL[1] + 1.0]) - low) / cell).astype(int)
    columns, rows = np.floor((posts - low) / cell).astype(int).T
    occupied = np.zeros((height, width), bool)
    occupied[rows, columns] = True
    passable = distance_to_cells(occupied, cell) > passage + RADIUS - cell / 2
    ends = [np.floor((np.array(point[:2]) - low) / cell).astype(int) for point in (START, GOAL)]
    start, goal = ((int(y), int(x)) for x, y in ends)
    return cell * grid_path(passable, start, goal)[0]


def world_of_scene(scene: FamilyScene, name: str) -> World:
    """Turn every occupied cell of a scene into a post as wide as the cell, and fence it in.

    The robot starts at rest and faces the goal. Posts enclosed by others are left out.

    Raises `BenchmarkError` if the scene has no way for the robot, or no room at an end.
    """
    # past the posts' rims
    length = shortest_way(replace(scene, robot_radius=PASSAGE + 0.5 * scene.resolution))
    if not np.isfinite(length):
        raise BenchmarkError(f"{name}: expected a way for a robot of {PASSAGE} m, got none")
    posts = posts_of_cells(scene.occupied, scene.resolution, scene.origin)
    start, goal = scene.x_curr[:2].astype(np.float64), scene.x_goal[:2].astype(np.float64)
    ahead = goal - start
    world = World(
        name=name,
        posts=posts,
        post_radius=0.5 * scene.resolution,
        start=np.array([*start, np.arctan2(ahead[1], ahead[0])]),
        goal=goal,
        path_length=length,
    )
    if (room := room_at_ends(world)) < 0.0:
        raise BenchmarkError(f"{name}: expected {PASSAGE} m round both ends, {-room:.2f} m lack")
    return world


def posts_of_cells(occupied: NDArray[np.bool_], resolution: float, origin: Array) -> Array:
    """Return [M, 2] m, the centres of the occupied cells [H, W] and of a fence round the grid.

    Cells enclosed by others are left out; `origin` [2] m is the outer corner of cell (0, 0).
    """
    fenced = np.pad(occupied, 1, constant_values=True)
    inner = np.asarray(binary_erosion(fenced, EIGHT_NEIGHBOURS, border_value=1), bool)
    rows, columns = np.nonzero(fenced & ~inner)
    return origin + resolution * (np.stack([columns, rows], 1) - 0.5)


def room_at_ends(world: World) -> float:
    """Return the m beyond PASSAGE round start and goal, the fence included."""
    return min(world.clearance(end, PASSAGE) for end in (world.start[:2], world.goal))


def draw_forests(count: int, seed: int, *, min_gap: float = MIN_GAP) -> list[World]:
    """Draw forests with the generator of training; none of them is in a dataset.

    min_gap: m to spare on either side of the robot on the widest way
    """
    passable = (world for world in _forests(seed) if world.to_spare >= min_gap)
    return list(islice(passable, count))


def _forests(seed: int) -> Iterator[World]:
    low, high = SIDES
    for index, scene in enumerate(held_out_scenes(seed, limits=LIMITS)):
        side = scene.resolution * len(scene.occupied)
        if scene.family not in FAMILIES or not low <= side <= high:
            continue
        try:
            world = world_of_scene(scene, f"drawn {scene.family} {index}")
        except BenchmarkError:  # drawn for a smaller robot
            continue
        if world.path_length >= MIN_WAY:
            yield world


def widest_way(
    posts: Array, post_radius: float, start: Array, goal: Array, *, most: float = 2.0
) -> float:
    """Return the smallest m between posts' rims and the widest way from start to goal.

    posts: [M, 2] m; start, goal: [2] m; most: m, upper bound of the result
    """
    ends = np.stack([start, goal])
    points = np.concatenate([posts, ends])
    low = points.min(0) - MARGIN
    width, height = np.ceil((points.max(0) + MARGIN - low) / CELL).astype(int)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = low + CELL * np.stack([x, y], -1)
    if not len(posts):
        return most
    nearest, _ = KDTree(posts).query(centres.reshape(-1, 2), distance_upper_bound=2 * most)
    room = np.minimum(nearest.reshape(height, width) - post_radius, most)
    (start_column, start_row), (goal_column, goal_row) = ((ends - low) / CELL).astype(int)
    narrow, wide = 0.0, float(min(room[start_row, start_column], room[goal_row, goal_column]))
    regions = np.zeros(room.shape, np.int32)
    for _ in range(HALVINGS):
        middle = 0.5 * (narrow + wide)
        label(room >= middle, EIGHT_NEIGHBOURS, output=regions)
        if regions[start_row, start_column] == regions[goal_row, goal_column] > 0:
            narrow = middle
        else:
            wide = middle
    return narrow
