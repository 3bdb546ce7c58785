"""Forests, and other scenes on a grid, as worlds: obstacles all over, many ways between them.

A corridor of BARN's has walls and one or two ways through; a forest has a choice of several.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
from scipy.ndimage import binary_erosion

from anchorflow_benchmarks.closed_loop.world import LEAST_GAP, PASSAGE, World
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.grid_path import shortest_way
from anchorflow_benchmarks.scene_files import held_out_scenes
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits

FAMILIES = ("forest", "discs")  # of the generator: blocks and discs on open ground
SIDES = (9.0, 16.0)  # m, of a drawn forest
LEAST_WAY = 6.0  # m; GOAL_TOLERANCE would make more than a fifth of less
LIMITS = MotionLimits(v_max=2.0, a_max=3.0)  # of the robots
EIGHT_NEIGHBOURS = np.ones((3, 3), bool)


def world_of_scene(scene: FamilyScene, name: str) -> World:
    """A scene in which every occupied cell is a post as wide as the cell, with a fence round it.

    The robot starts at rest and faces the goal. Posts that others hide from all sides are left out.

    Raises:
        BenchmarkError: the scene has no way for the robot, or no room at an end of it.
    """
    length = way_between_posts(scene)
    if not np.isfinite(length):
        raise BenchmarkError(f"{name}: expected a way for a robot of {PASSAGE} m, got none")
    fenced = np.pad(scene.occupied, 1, constant_values=True)
    inner = np.asarray(binary_erosion(fenced, EIGHT_NEIGHBOURS, border_value=1), bool)
    rows, columns = np.nonzero(fenced & ~inner)
    posts = scene.origin + scene.resolution * (np.stack([columns, rows], 1) - 0.5)
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


def way_between_posts(scene: FamilyScene) -> float:
    """m of the shortest way of PASSAGE past the posts' rims; NaN where there is none."""
    return shortest_way(replace(scene, robot_radius=PASSAGE + 0.5 * scene.resolution))


def room_at_ends(world: World) -> float:
    """m beyond PASSAGE round start and goal, the fence included."""
    return min(world.clearance(end, PASSAGE) for end in (world.start[:2], world.goal))


def draw_forests(count: int, seed: int, *, least_gap: float = LEAST_GAP) -> list[World]:
    """Forests of the generator that training uses, none of which is in a dataset.

    least_gap: m that the widest way of each leaves a robot to spare on either side
    """
    passable = (world for world in _forests(seed) if world.to_spare >= least_gap)
    return list(islice(passable, count))


def _forests(seed: int) -> Iterator[World]:
    low, high = SIDES
    for index, scene in enumerate(held_out_scenes(seed, limits=LIMITS)):
        side = scene.resolution * len(scene.occupied)
        if scene.family not in FAMILIES or not low <= side <= high:
            continue
        try:
            world = world_of_scene(scene, f"drawn {scene.family} {index}")
        except BenchmarkError:  # it was drawn for a smaller robot
            continue
        if world.path_length >= LEAST_WAY:
            yield world
