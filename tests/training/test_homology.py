"""Homology classes: which side of what a trajectory passes."""

import numpy as np

from anchorflow_training.data.inspection import homology_classes, obstacle_points

RESOLUTION, ORIGIN = 0.1, np.array([-3.0, -2.0])


def detour(height: float) -> np.ndarray:
    """[T, 2] from (-2, 0) to (2, 0), highest in the middle."""
    s = np.linspace(0.0, 1.0, 40)
    return np.stack([-2.0 + 4.0 * s, height * np.sin(np.pi * s)], -1)


def clearance(*posts: tuple[float, float]) -> np.ndarray:
    y, x = np.indices((40, 60)) * RESOLUTION + 0.5 * RESOLUTION
    distance = [np.hypot(x + ORIGIN[0] - px, y + ORIGIN[1] - py) - 0.3 for px, py in posts]
    return np.min(distance, axis=0).astype(np.float32)


def test_a_point_lies_in_each_obstacle() -> None:
    posts = [(-1.0, 0.0), (1.0, 0.5)]
    points = obstacle_points(clearance(*posts), RESOLUTION, ORIGIN)
    np.testing.assert_allclose(points[np.argsort(points[:, 0])], posts, atol=RESOLUTION)
    touching = obstacle_points(clearance((0.0, 0.0), (0.5, 0.0)), RESOLUTION, ORIGIN)
    assert len(touching) == 1


def test_sides_of_one_post() -> None:
    points = obstacle_points(clearance((0.0, 0.0)), RESOLUTION, ORIGIN)
    paths = np.stack([detour(1.0), detour(-1.0), detour(1.5), detour(-0.7)])
    above, below, higher, lower = homology_classes(paths, points)
    assert above == higher != below
    assert below == lower


def test_a_loop_round_a_post_is_a_class_of_its_own() -> None:
    points = np.array([[0.0, 0.0]])
    angle = np.linspace(np.pi, 3 * np.pi + np.pi, 40)  # round and half round again
    loop = 1.5 * np.stack([np.cos(angle), np.sin(angle)], -1)
    loop[0], loop[-1] = (-2.0, 0.0), (2.0, 0.0)
    half = np.pi - np.linspace(0, np.pi, 40)
    plain = 1.5 * np.stack([np.cos(half), np.sin(half)], -1)
    plain[0], plain[-1] = (-2.0, 0.0), (2.0, 0.0)
    assert len(np.unique(homology_classes(np.stack([plain, loop]), points))) == 2


def test_two_posts_give_up_to_four_ways() -> None:
    points = np.array([[-1.0, 0.0], [1.0, 0.0]])
    s = np.linspace(0.0, 1.0, 40)
    zigzag = np.stack([-2.0 + 4.0 * s, np.sin(2 * np.pi * s)], -1)
    paths = np.stack([detour(1.0), detour(-1.0), zigzag, zigzag * [1, -1]])
    assert len(np.unique(homology_classes(paths, points))) == 4


def test_without_obstacles_there_is_one_way() -> None:
    points = obstacle_points(np.ones((10, 10), np.float32), 0.1, np.zeros(2))
    assert points.shape == (0, 2)
    np.testing.assert_array_equal(
        homology_classes(np.stack([detour(1.0), detour(-1.0)]), points), [0, 0]
    )
