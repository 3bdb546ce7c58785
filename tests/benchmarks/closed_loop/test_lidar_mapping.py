"""The lidar against circles in closed form, and the map that is built from its scans."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from anchorflow_benchmarks.closed_loop.lidar_mapping import Lidar, LocalMap, ray_distances
from anchorflow_benchmarks.closed_loop.worlds import World


@pytest.mark.parametrize(
    ("centres", "angle", "expected"),
    [
        ([[3.0, 0.0]], 0.0, 2.5),
        # The ray passes the centre at 0.3 m.
        ([[3.0, 0.0]], np.arcsin(0.1), np.sqrt(9.0 - 0.09) - np.sqrt(0.25 - 0.09)),
        ([[3.0, 0.0]], np.pi, np.inf),
        ([[3.0, 0.0]], 0.5 * np.pi, np.inf),
        ([[3.0, 0.0]], np.arcsin(0.5 / 3.0) + 1e-4, np.inf),
        ([[5.0, 0.0], [2.0, 0.0], [3.0, 0.0]], 0.0, 1.5),
        (np.zeros((0, 2)), 0.0, np.inf),
    ],
)
def test_a_ray_ends_at_the_nearest_rim(centres: Any, angle: float, expected: float) -> None:
    found = ray_distances(np.array(centres, np.float64), 0.5, np.array([angle]))
    assert found == pytest.approx([expected])


def test_a_scan_turns_with_the_robot_and_ends_at_its_range(world: Callable[..., World]) -> None:
    lidar = Lidar(np.pi, beams=181, max_range=4.0, noise=0.0)
    posts = world([(0.0, 3.0), (0.0, -6.0)])
    scan = lidar.scan(posts, np.array([0.0, 0.0, np.pi / 2]), np.random.default_rng(0))

    assert scan.bearings[90] == pytest.approx(0.0)
    assert scan.ranges[90] == pytest.approx(2.9, abs=1e-5)
    assert scan.hits.sum() < 10  # a post of 0.1 m at 3 m is four degrees wide
    assert (scan.ranges[~scan.hits] == 4.0).all()
    behind = lidar.scan(posts, np.array([0.0, 0.0, -np.pi / 2]), np.random.default_rng(0))
    assert not behind.hits.any()  # the other post is out of range


def test_noise_has_the_spread_that_was_asked_for(world: Callable[..., World]) -> None:
    lidar = Lidar(0.001, beams=2000, noise=0.02)
    scan = lidar.scan(world([(3.0, 0.0)]), np.zeros(3), np.random.default_rng(0))

    assert scan.ranges.std() == pytest.approx(0.02, rel=0.1)
    assert scan.ranges.mean() == pytest.approx(2.9, abs=0.002)


LIDAR = Lidar(2 * np.pi, noise=0.0)
AHEAD = Lidar(np.pi, noise=0.0)


def seen(
    local: LocalMap, world: World, *places: tuple[float, float], lidar: Lidar = LIDAR
) -> LocalMap:
    for x, y in places:
        local.add(lidar.scan(world, np.array([x, y, 0.0]), np.random.default_rng(0)))
    return local


def cells(local: LocalMap) -> np.ndarray:
    """[M, 2] m, centres of the occupied cells."""
    rows, columns = np.nonzero(local.occupied)
    return local.origin + local.resolution * (np.stack([columns, rows], 1) + 0.5)


def test_only_the_side_of_a_post_that_was_seen_is_mapped(world: Callable[..., World]) -> None:
    posts = world([(2.0, 0.0)], post_radius=0.3)
    mapped = cells(seen(LocalMap(), posts, (0.0, 0.0)))

    distance = np.linalg.norm(mapped - [2.0, 0.0], axis=1)
    assert len(mapped) >= 5
    assert (np.abs(distance - 0.3) < 0.08).all()
    assert (mapped[:, 0] < 2.0).all()


def test_hidden_posts_and_those_behind_are_not_known(world: Callable[..., World]) -> None:
    hidden = cells(seen(LocalMap(), world([(2.0, 0.0), (4.0, 0.0)]), (0.0, 0.0)))
    behind = seen(LocalMap(), world([(-2.0, 0.0)]), (0.0, 0.0), lidar=AHEAD)

    assert (hidden[:, 0] < 3.0).all()
    assert not behind.occupied.any()


def test_the_window_moves_and_the_posts_stay(world: Callable[..., World]) -> None:
    local = seen(LocalMap(), world([(2.0, 1.0)]), (0.0, 0.0))
    before = cells(local)
    # Blind on its way: what it still knows it has carried along.
    seen(local, world(), (0.7, -0.3), lidar=Lidar(0.02, noise=0.0))
    after = cells(local)

    np.testing.assert_allclose(np.sort(after, 0), np.sort(before, 0), atol=1e-9)
    assert np.abs(local.origin + 64 * 0.08 - [0.7, -0.3]).max() <= 0.08


@pytest.mark.parametrize("way", [[(6.0, 0.0), (0.0, 0.0)], [(100.0, -50.0)]])
def test_cells_that_leave_the_window_are_forgotten(
    way: list[tuple[float, float]], world: Callable[..., World]
) -> None:
    local = seen(LocalMap(), world([(-2.0, 0.0)]), (0.0, 0.0))
    assert local.occupied.any()
    assert not seen(local, world(), *way).occupied.any()


def test_a_false_hit_is_looked_through_later(world: Callable[..., World]) -> None:
    local = seen(LocalMap(), world([(2.0, 0.0)]), (0.0, 0.0))
    seen(local, world(), *[(0.0, 0.0)] * 5)
    assert not local.occupied.any()


def test_the_robots_own_place_is_free(world: Callable[..., World]) -> None:
    local = seen(LocalMap(), world([(0.3, 0.0), (2.0, 0.0)]), (0.0, 0.0))
    near = np.linalg.norm(cells(local), axis=1) <= 0.25
    assert near.any()
    left = local.occupied_beyond(np.zeros(2), 0.25)
    assert left.sum() == (~near).sum()


def wall(x: float) -> np.ndarray:
    """[M, 2] m, centres of posts of 0.1 m with their nearest rims at x."""
    y = np.arange(-1.5, 1.51, 0.02)
    return np.stack([np.full_like(y, x + 0.1), y], 1)


def test_the_place_of_the_hits_is_nearer_to_a_wall_than_the_cells(
    world: Callable[..., World],
) -> None:
    noisy, rng = Lidar(np.pi / 3, noise=0.02), np.random.default_rng(0)
    local = LocalMap(cells=128, resolution=0.05)
    for _ in range(20):
        local.add(noisy.scan(world(wall(2.03)), np.zeros(3), rng))
    rows, columns = np.nonzero(local.occupied)
    x, y = local.surface[rows, columns].T
    front = [x[rows == row].min() for row in np.unique(rows[np.abs(y) < 0.5])]

    np.testing.assert_allclose(front, 2.03, atol=0.015)  # the cells begin at 2.00
    np.testing.assert_array_equal(np.floor(x / 0.05) - np.floor(local.origin[0] / 0.05), columns)


def test_a_beam_that_ends_early_marks_no_cell_through_which_others_pass(
    world: Callable[..., World],
) -> None:
    # 2 cm behind the border of a cell, so that one beam in 44 ends before it.
    noisy, rng = Lidar(np.pi / 3, noise=0.01), np.random.default_rng(0)
    local = LocalMap(cells=128, resolution=0.05)
    for _ in range(40):
        local.add(noisy.scan(world(wall(2.02)), np.zeros(3), rng))
    before = cells(local)[cells(local)[:, 0] < 2.0]
    assert len(before) <= 0.05 * len(cells(local))
