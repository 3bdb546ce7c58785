"""Forests and other scenes as worlds of posts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anchorflow_benchmarks.closed_loop.forests import (
    FAMILIES,
    LEAST_WAY,
    SIDES,
    draw_forests,
    room_at_ends,
)
from anchorflow_benchmarks.closed_loop.lidar import ray_distances
from anchorflow_benchmarks.closed_loop.world_sources import load_worlds
from anchorflow_benchmarks.errors import BenchmarkError

CELLS, RESOLUTION = 64, 0.1  # 6.4 m a side


def write_scenes(
    path: Path, blocks: list[tuple[slice, slice]], *, start: tuple[float, float] = (-2.5, -2.0)
) -> str:
    """One scene to (2.5, 2) and its blocks of occupied cells, in a file."""
    occupied = np.zeros((CELLS, CELLS), bool)
    for block in blocks:
        occupied[block] = True
    np.savez(
        path,
        occupancy=np.packbits(occupied[None], axis=-1),
        resolution=RESOLUTION,
        x_curr=np.array([[*start, 1.0, 0.0, 0.0, 0.0]], np.float32),
        x_goal=np.array([[2.5, 2.0, 0.0, 0.0]], np.float32),
        robot_radius=0.25,
        family=np.array(["forest"]),
    )
    return str(path)


def test_a_scene_of_a_file_is_a_world(tmp_path: Path) -> None:
    (world,) = load_worlds(write_scenes(tmp_path / "a.npz", [(slice(30, 34), slice(28, 36))]))

    assert world.name == "forest 0"
    assert world.start == pytest.approx([-2.5, -2.0, np.arctan2(4.0, 5.0)])
    assert world.goal == pytest.approx([2.5, 2.0])
    assert np.hypot(5.0, 4.0) < world.path_length < 1.1 * np.hypot(5.0, 4.0)
    # The block's lower edge is at y = -0.2, its left one at x = -0.4.
    assert world.clearance(np.array([0.0, -1.0]), 0.25) == pytest.approx(0.8 - 0.25, abs=0.02)
    (ahead,) = ray_distances(world.posts - np.array([-2.0, 0.05]), world.post_radius, np.zeros(1))
    assert ahead == pytest.approx(1.6, abs=0.01)


def test_the_edge_of_a_scene_is_a_fence_without_a_gap(tmp_path: Path) -> None:
    (world,) = load_worlds(write_scenes(tmp_path / "a.npz", []))
    angles = np.linspace(0.0, 2.0 * np.pi, 1000)
    seen = ray_distances(world.posts, world.post_radius, angles)

    assert seen.min() == pytest.approx(3.2, abs=0.06)
    assert seen.max() < 3.3 * np.sqrt(2.0)


def test_what_stands_inside_an_obstacle_is_no_post(tmp_path: Path) -> None:
    (bare,) = load_worlds(write_scenes(tmp_path / "a.npz", []))
    (block,) = load_worlds(write_scenes(tmp_path / "b.npz", [(slice(20, 40), slice(20, 40))]))

    assert len(block.posts) - len(bare.posts) == 4 * 19  # the rim of 20 x 20


def test_a_scene_without_a_way_is_named(tmp_path: Path) -> None:
    wall = write_scenes(tmp_path / "a.npz", [(slice(None), slice(32, 34))])
    with pytest.raises(BenchmarkError, match=r"forest 0: expected a way for a robot of 0\.3 m"):
        load_worlds(wall)


def test_a_start_too_near_to_something_is_named(tmp_path: Path) -> None:
    near = write_scenes(tmp_path / "a.npz", [], start=(-3.0, -2.0))  # 0.2 m from the fence
    with pytest.raises(BenchmarkError, match=r"0: expected 0\.3 m round both ends, 0\.10 m lack"):
        load_worlds(near)


def test_a_gap_between_posts_counts_from_their_rims(tmp_path: Path) -> None:
    def gap(cells: int) -> str:
        upper, lower = slice(32 + cells // 2, None), slice(None, 32 - cells // 2)
        walls = [(rows, slice(32, 34)) for rows in (upper, lower)]
        return write_scenes(tmp_path / f"{cells}.npz", walls)

    load_worlds(gap(8))  # 0.8 m
    with pytest.raises(BenchmarkError, match="expected a way"):
        load_worlds(gap(6))  # 0.6 m is PASSAGE and nothing to spare


def test_drawn_forests_are_the_same_for_a_seed_and_can_be_crossed() -> None:
    worlds, again, others = draw_forests(3, 1), draw_forests(3, 1), draw_forests(3, 2)

    for world, same, other in zip(worlds, again, others, strict=True):
        np.testing.assert_array_equal(world.posts, same.posts)
        assert world.name == same.name
        assert world.posts.shape != other.posts.shape or (world.posts != other.posts).any()
        assert world.name.split()[1] in FAMILIES
        assert world.path_length >= LEAST_WAY
        low, high = SIDES
        fence = np.ptp(world.posts, axis=0) - 2 * world.post_radius  # its inner side
        assert (fence >= low - 1e-6).all()
        assert (fence <= high + 1e-6).all()
        assert room_at_ends(world) >= 0.0


def test_the_public_forests(shared_data: Callable[[str], Path]) -> None:
    worlds = load_worlds(str(shared_data("forests_public.npz")), limit=50)

    assert len(worlds) == 50
    assert all(world.path_length >= LEAST_WAY for world in worlds)
