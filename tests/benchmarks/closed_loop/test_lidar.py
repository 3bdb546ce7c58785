"""The lidar against circles in closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from anchorflow_benchmarks.closed_loop.lidar import Lidar, ray_distances
from anchorflow_benchmarks.closed_loop.world import World


def test_a_circle_straight_ahead_is_its_distance_less_its_radius() -> None:
    assert ray_distances(np.array([[3.0, 0.0]]), 0.5, np.zeros(1)) == pytest.approx([2.5])


def test_a_circle_met_off_its_centre_is_met_on_its_rim() -> None:
    angle = np.arcsin(0.3 / 3.0)  # the ray passes the centre at 0.3 m
    expected = np.sqrt(9.0 - 0.09) - np.sqrt(0.25 - 0.09)

    assert ray_distances(np.array([[3.0, 0.0]]), 0.5, np.array([angle])) == pytest.approx(
        [expected]
    )


@pytest.mark.parametrize("angle", [np.pi, 0.5 * np.pi, np.arcsin(0.5 / 3.0) + 1e-4])
def test_a_ray_that_misses_goes_on_for_ever(angle: float) -> None:
    assert ray_distances(np.array([[3.0, 0.0]]), 0.5, np.array([angle])) == np.inf


def test_the_nearest_of_several_is_seen() -> None:
    centres = np.array([[5.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    assert ray_distances(centres, 0.5, np.zeros(1)) == pytest.approx([1.5])


def test_no_circles_no_distances() -> None:
    assert (ray_distances(np.zeros((0, 2)), 0.5, np.zeros(4)) == np.inf).all()


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
