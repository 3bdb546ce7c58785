"""Worlds out of files, and drawn."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anchorflow_benchmarks.closed_loop.world import GOAL, draw_world
from anchorflow_benchmarks.closed_loop.world_sources import load_worlds
from anchorflow_benchmarks.errors import BenchmarkError


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


@pytest.mark.parametrize("missing", ["offsets", "goal", "radius"])
def test_a_file_of_something_else_is_named(missing: str, tmp_path: Path) -> None:
    path = write_worlds(tmp_path / "worlds.npz", **{missing: None})
    with pytest.raises(
        BenchmarkError, match=rf"not a file of worlds \(expected the key '{missing}'"
    ):
        load_worlds(str(path))


def test_an_empty_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "worlds.npz"
    path.touch()
    with pytest.raises(BenchmarkError, match="not a file of worlds"):
        load_worlds(str(path))


def test_lengths_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path = write_worlds(tmp_path / "worlds.npz", path_length=np.ones(3))
    with pytest.raises(BenchmarkError, match="not a file of worlds"):
        load_worlds(str(path))


@pytest.mark.parametrize(
    "text", ["drawn:", "drawn:2", "drawn:0:1", "drawn:2:-1", "drawn:a:1", "forests:", "forests:0:1"]
)
def test_worlds_to_draw_are_counted_and_seeded(text: str) -> None:
    with pytest.raises(BenchmarkError, match=rf"expected .*, got {text}"):
        load_worlds(text)


def test_fewer_worlds_are_spread_evenly() -> None:
    all_of_them, some = load_worlds("drawn:5:0"), load_worlds("drawn:5:0", limit=3)
    assert [w.name for w in some] == [all_of_them[i].name for i in (0, 2, 4)]


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
