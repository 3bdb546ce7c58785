"""Frames, boxes, polygons, routes and the drivable area against what is known of them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, strategies as st

from anchorflow_driving.drivers import waypoint_headings
from anchorflow_driving.geometry import (
    box_corners,
    boxes_overlap,
    into_frame,
    out_of_frame,
    points_in_polygon,
    wrap_angle,
)
from anchorflow_driving.road import TILE, DrivableGrid, cells_inside
from anchorflow_driving.route import Route

numbers = st.floats(-50, 50)
poses = st.tuples(numbers, numbers, st.floats(-7, 7)).map(np.array)
SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


@given(pose=poses, frame=poses)
def test_into_a_frame_and_out_again(pose: np.ndarray, frame: np.ndarray) -> None:
    np.testing.assert_allclose(out_of_frame(into_frame(pose, frame), frame), pose, atol=1e-12)


def test_a_frame_looks_along_x() -> None:
    seen = into_frame(np.array([3.0, 5.0, np.pi]), np.array([3.0, 2.0, np.pi / 2]))

    np.testing.assert_allclose(seen, [3.0, 0.0, np.pi / 2], atol=1e-12)


def test_angles_wrap() -> None:
    wrapped = wrap_angle(np.array([0.0, 4.0, -4.0, 2 * np.pi]))

    np.testing.assert_allclose(wrapped, [0, 4 - 2 * np.pi, 2 * np.pi - 4, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("pose", "touch"),
    [
        ((3.99, 0, 0), True),
        ((4.01, 0, 0), False),
        ((0, 1.99, 0), True),
        ((0, 2.01, 0), False),
        ((0, 2.99, np.pi / 2), True),
        ((0, 3.01, np.pi / 2), False),
        # The circles round both boxes meet; a diagonal side keeps them apart.
        ((3.2, 2.2, -np.pi / 4), False),
        ((3.2, 2.2, np.pi / 4), True),
        ((2.5, 1.8, -np.pi / 4), True),
    ],
)
def test_boxes_of_4_by_2(pose: tuple[float, float, float], touch: bool) -> None:
    here, there, size = np.zeros(3), np.array(pose, float), np.array([4.0, 2.0])

    assert boxes_overlap(here, size, there, size) == touch
    assert boxes_overlap(there, size, here, size) == touch


@given(a=poses, b=poses, frame=poses)
def test_boxes_overlap_where_a_point_lies_in_both(
    a: np.ndarray, b: np.ndarray, frame: np.ndarray
) -> None:
    """A dense sample of one box against the other: it cannot find what is not there."""
    b = np.array([a[0] + b[0] / 10, a[1] + b[1] / 10, b[2]])
    size, other = np.array([4.0, 2.0]), np.array([6.0, 1.0])
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 41)] * 2), -1).reshape(-1, 2)
    inside = np.abs(into_frame(out_of_frame(grid * other, b), a)) <= size / 2

    overlap = boxes_overlap(a, size, b, other)
    if inside.all(-1).any():
        assert overlap
    moved, other_moved = out_of_frame(a, frame), out_of_frame(b, frame)
    smaller, larger = 1 - 1e-9, 1 + 1e-9
    assert boxes_overlap(moved, size * larger, other_moved, other * larger) >= overlap
    assert boxes_overlap(moved, size * smaller, other_moved, other * smaller) <= overlap


def test_corners_lie_half_a_size_away() -> None:
    corners = box_corners(np.array([1.0, 2.0, np.pi / 2]), np.array([4.0, 2.0]))

    np.testing.assert_allclose(corners, [[0, 4], [2, 4], [2, 0], [0, 0]], atol=1e-12)


def test_points_in_a_square() -> None:
    points = np.array([[5.0, 5.0], [-1.0, 5.0], [11.0, 5.0], [5.0, -1.0], [9.9, 0.1]])

    assert points_in_polygon(points, SQUARE).tolist() == [True, False, False, False, True]


def test_a_ring_within_a_ring_is_a_hole() -> None:
    grid = DrivableGrid((SQUARE, SQUARE[::-1] * 0.4 + 3.0))
    points = np.array([[1.0, 1.0], [5.0, 5.0], [2.9, 5.0], [7.1, 5.0], [-0.5, 5.0], [99.0, 5.0]])

    assert grid.holds(points).tolist() == [True, False, True, True, False, False]


@given(st.integers(0, 10_000))
def test_the_grid_agrees_with_the_polygons_off_their_edges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 9))
    reach = rng.uniform(2, 9, 9)[:, None]
    star = reach * np.stack([np.cos(angle), np.sin(angle)], -1)
    points = rng.uniform(-10, 10, (200, 2))
    ends = np.roll(star, -1, 0)
    share = ((points[:, None] - star) * (ends - star)).sum(-1) / ((ends - star) ** 2).sum(-1)
    foot = star + share.clip(0, 1)[..., None] * (ends - star)
    clear = np.linalg.norm(points[:, None] - foot, axis=-1).min(1) > 0.15

    found = DrivableGrid((star,)).holds(points)

    assert (found == points_in_polygon(points, star))[clear].all()


@given(st.integers(0, 10_000))
def test_cells_of_a_part_are_those_of_the_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = rng.uniform(-20, 80, (30, 2))
    whole = cells_inside(start, np.roll(start, -1, axis=0), (70, 60))
    row, column = (int(at) for at in rng.integers(0, 50, 2))

    part = cells_inside(start, np.roll(start, -1, axis=0), (20, 10), first=(row, column))

    np.testing.assert_array_equal(part, whole[row : row + 20, column : column + 10])


def test_a_map_of_many_km_is_worked_out_where_it_is_asked() -> None:
    """As one array its cells would take 10 GB."""
    grid = DrivableGrid((SQUARE * 1000.0, SQUARE + 4990.0))
    rim = 0.1 * TILE * np.arange(1, 4) - 1.0  # of tiles
    points = np.concatenate([np.stack([rim, rim], -1), [[4995.0, 4995.0], [9999.0, -0.5]]])

    assert grid.holds(points).tolist() == [True, True, True, False, False]
    assert grid.holds(points[3]) == np.False_


def test_threads_that_ask_at_once_are_told_alike() -> None:
    square = SQUARE * 16.0
    points = np.random.default_rng(0).uniform(-20, 180, (64, 8, 2))
    expected = DrivableGrid((square,)).holds(points)
    with ThreadPoolExecutor(8) as pool:
        for _ in range(20):
            found = np.stack(list(pool.map(DrivableGrid((square,)).holds, points)))
            np.testing.assert_array_equal(found, expected)


@given(s=st.floats(1, 38), left=st.floats(-3, 3))
def test_a_place_beside_a_route_is_projected_back(s: float, left: float) -> None:
    angle = np.linspace(0, 1.3, 400)
    route = Route(30 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1))

    arc_length, offset = route.project(route.poses(np.array(s), left)[..., :2])

    assert offset == pytest.approx(left, abs=1e-2)
    assert arc_length == pytest.approx(s, abs=0.06)


def test_a_route_goes_straight_on_beyond_its_ends() -> None:
    route = Route(np.array([[0.0, 0.0], [0.0, 0.0], [10.0, 0.0]]))

    poses = route.poses(np.array([-2.0, 4.0, 13.0]), 1.0)

    np.testing.assert_allclose(poses, [[-2, 1, 0], [4, 1, 0], [13, 1, 0]], atol=1e-12)


def test_who_stands_keeps_its_heading() -> None:
    waypoints = np.array([[0.01, 0], [1, 0], [1, 1], [1.01, 1.01], [0, 1.01]])

    headings = waypoint_headings(waypoints)

    np.testing.assert_allclose(headings, [0, 0, np.pi / 2, np.pi / 2, np.pi])
