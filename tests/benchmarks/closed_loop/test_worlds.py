"""Worlds from files, drawn corridors and forests, and scenes as worlds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.closed_loop.lidar_mapping import ray_distances
from anchorflow_benchmarks.closed_loop.worlds import (
    FAMILIES,
    GOAL,
    MIN_WAY,
    SIDES,
    draw_forests,
    draw_world,
    load_worlds,
    room_at_ends,
)


def write_worlds(path: Path, **changed: object) -> Path:
    """Two worlds: of two posts and of one."""
    arrays: dict[str, object] = {
        "world": np.array([4, 9]),
        "cylinders": np.array([[0, 1], [0, 2], [5, 5]], np.float32),
        "offsets": np.array([0, 2, 3]),
        "radius": np.float32(0.1),
        "start": np.zeros(3, np.float32),
        "goal": np.array([10, 0], np.float32),
        "path_length": np.array([10.5, 11.0], np.float32),
    }
    np.savez(path, **{k: v for k, v in (arrays | changed).items() if v is not None})  # type: ignore[arg-type]
    return path


def test_a_file_of_worlds(tmp_path: Path) -> None:
    first, second = load_worlds(str(write_worlds(tmp_path / "worlds.npz")))

    assert (first.name, second.name) == ("BARN 4", "BARN 9")
    assert first.posts.tolist() == [[0, 1], [0, 2]]
    assert second.posts.tolist() == [[5, 5]]
    assert (second.path_length, second.post_radius) == (11.0, pytest.approx(0.1))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"offsets": None}, "expected the key 'offsets'"),
        ({"goal": None}, "expected the key 'goal'"),
        ({"radius": None}, "expected the key 'radius'"),
        ({"path_length": np.ones(3)}, ""),
    ],
)
def test_a_file_of_something_else_is_named(
    changed: dict[str, object], said: str, tmp_path: Path
) -> None:
    path = write_worlds(tmp_path / "worlds.npz", **changed)
    with pytest.raises(BenchmarkError, match=rf"not a file of worlds \({said}"):
        load_worlds(str(path))
    path.write_bytes(b"")
    with pytest.raises(BenchmarkError, match="not a file of worlds"):
        load_worlds(str(path))


@pytest.mark.parametrize(
    "text", ["drawn:", "drawn:2", "drawn:0:1", "drawn:2:-1", "drawn:a:1", "forests:", "forests:0:1"]
)
def test_worlds_to_draw_are_counted_and_seeded(text: str) -> None:
    with pytest.raises(BenchmarkError, match=rf"expected .*, got {text}"):
        load_worlds(text)


@pytest.mark.parametrize("seed", range(5))
def test_a_drawn_world_leaves_start_and_goal_free_and_a_way_between_them(seed: int) -> None:
    world = draw_world(seed)
    assert world.clearance(world.start[:2], 0.25) > 0.5
    assert world.clearance(np.array(GOAL), 0.25) > 0.5
    assert 9.9 <= world.path_length < 20.0
    np.testing.assert_array_equal(world.posts, draw_world(seed).posts)


def test_the_widest_way_is_as_wide_as_its_narrowest_gap(world: Callable) -> None:
    line = np.arange(-3.0, 3.1, 0.1)
    wall = [(3.0, y) for y in line if not (0.45 < y < 1.15 or -1.75 < y < -0.65)]
    fence = [(x, y) for x in np.arange(-1.0, 7.1, 0.1) for y in (-3.0, 3.0)]
    ends = [(x, y) for x in (-1.0, 7.0) for y in line]
    shut = world(np.array(wall + fence + ends))

    # From centre to centre the wider gap is 1.2 m, and posts are 0.1 m round.
    assert shut.to_spare == pytest.approx(0.6 - 0.1 - 0.25, abs=0.03)
    assert world().to_spare > 1.0


def test_a_drawn_world_leaves_the_gap_that_was_asked_for() -> None:
    assert all(w.to_spare >= 0.12 for w in load_worlds("drawn:3:0:0.12"))
    assert load_worlds("forests:1:0:0.2")[0].to_spare >= 0.2
    assert all(0.04 <= w.to_spare <= 0.08 for w in load_worlds("narrow:2:0"))
    with pytest.raises(BenchmarkError, match=r"expected a GAP from 0 to 0\.25 m, got drawn:3:0:x"):
        load_worlds("drawn:3:0:x")


def test_clearance_is_between_rims(world: Callable) -> None:
    posts = world([(0.0, 3.0), (0.0, -1.0)])
    assert posts.clearance(np.zeros(2), 0.25) == pytest.approx(1.0 - 0.1 - 0.25)
    assert world().clearance(np.zeros(2), 0.25) == np.inf


def test_the_public_worlds(shared_data: Callable[[str], Path]) -> None:
    worlds = load_worlds(str(shared_data("barn_public.npz")))
    assert len(worlds) == 150
    for world in worlds:
        assert world.start.tolist() == pytest.approx([-2.25, 3.0, np.pi / 2])
        assert np.linalg.norm(world.goal - world.start[:2]) == pytest.approx(10.0)
        assert world.path_length >= 10.0
        assert world.clearance(world.start[:2], 0.25) > 0.5


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


@pytest.mark.parametrize(
    ("blocks", "start", "said"),
    [
        ([(slice(None), slice(32, 34))], (-2.5, -2.0), r"expected a way for a robot of 0\.3 m"),
        # 0.2 m from the fence
        ([], (-3.0, -2.0), r"expected 0\.3 m round both ends, 0\.10 m lack"),
    ],
)
def test_a_scene_that_the_robot_cannot_cross_is_named(
    blocks: list[tuple[slice, slice]], start: tuple[float, float], said: str, tmp_path: Path
) -> None:
    path = write_scenes(tmp_path / "a.npz", blocks, start=start)
    with pytest.raises(BenchmarkError, match=f"forest 0: {said}"):
        load_worlds(path)


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
        assert world.path_length >= MIN_WAY
        low, high = SIDES
        fence = np.ptp(world.posts, axis=0) - 2 * world.post_radius  # its inner side
        assert (fence >= low - 1e-6).all()
        assert (fence <= high + 1e-6).all()
        assert room_at_ends(world) >= 0.0
