"""The simulated lidar and the list of agents, on the made-up street."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from anchorflow_driving.log import PEDESTRIAN
from anchorflow_driving.sensors.agents import far_others, nearest_agents
from anchorflow_driving.sensors.lidar import (
    HEIGHT,
    simulated_lidar,
    simulated_lidar_before,
    simulated_points,
)
from anchorflow_driving.window import Window

AXLE = 0.2823 * 5.0
"""m from the ego's rear axle to the street's x = 0."""


def struck(histogram: np.ndarray) -> np.ndarray:
    """x and y of the cells that were hit, m."""
    return (np.argwhere(histogram[0] > 0) + 0.5) / 4 - 32


def above_ground(window: Window) -> np.ndarray:
    points = simulated_points(window.view)
    return points[points[:, 2] > 0.05]


def test_beams_end_on_the_near_face_of_a_car_ahead(on_street: Callable, other: type) -> None:
    points = above_ground(on_street(other(20.0, 0.0)))

    face = points[np.abs(points[:, 1]) < 0.9]
    assert face[:, 0].min() == pytest.approx(20.0 + AXLE - 2.5, abs=1e-3)
    assert face[:, 0].max() <= 20.0 + AXLE + 2.5 + 1e-3  # the roof is seen from above
    assert face[:, 2].max() <= 1.55 + 1e-3


def test_who_is_hidden_is_not_hit(on_street: Callable, other: type) -> None:
    lorry = other(12.0, 0.0, size=(8.0, 2.5))
    alone = above_ground(on_street(other(30.0, 0.0, size=(4.0, 1.6))))
    hidden = above_ground(on_street(lorry, other(30.0, 0.0, size=(4.0, 1.6))))

    assert (alone[:, 0] > 25).any()
    assert not (hidden[:, 0] > 25).any()


def test_the_ground_is_left_out_of_the_histogram(on_street: Callable, other: type) -> None:
    empty = on_street()
    assert simulated_points(empty.view)[:, 2] == pytest.approx(0.0, abs=1e-4)
    assert not simulated_lidar(empty.view).any()

    histogram = simulated_lidar(on_street(other(10.0, 4.0)).view)[0]
    x, y = (np.argwhere(histogram > 0).T + 0.5) / 4 - 32
    assert x.min() > 7.0
    assert x.max() < 14.5
    assert y.min() > 2.5
    assert y.max() < 5.5


def test_a_turned_box_is_hit_where_it_stands(on_street: Callable, other: type) -> None:
    points = above_ground(on_street(other(15.0, 0.0, heading=np.pi / 2)))

    assert points[:, 0].min() == pytest.approx(15.0 + AXLE - 1.0, abs=1e-3)
    assert np.abs(points[:, 1]).max() == pytest.approx(2.5, abs=0.15)
    assert points[:, 2].max() < HEIGHT


def test_agents_are_the_nearest_vehicles_in_range(on_street: Callable, other: type) -> None:
    boxes, velocity, there = nearest_agents(
        on_street(
            other(20.0, 4.0, 3.0, heading=0.1, size=(4.0, 1.8)),
            other(-10.0, 0.0),
            other(5.0, -3.0, kind=PEDESTRIAN, size=(0.6, 0.6)),
            other(40.0, 0.0),
        ).view
    )

    assert boxes.shape == (30, 5)
    assert there.sum() == 2
    np.testing.assert_allclose(boxes[0], [-10.0 + AXLE, 0.0, 0.0, 5.0, 2.0], atol=1e-4)
    np.testing.assert_allclose(boxes[1], [20.0 + AXLE, 4.0, 0.1, 4.0, 1.8], atol=1e-4)
    assert not boxes[2:].any()
    np.testing.assert_allclose(
        velocity[:2], [[0.0, 0.0], [3 * np.cos(0.1), 3 * np.sin(0.1)]], atol=1e-5
    )


def test_far_others_are_all_that_stand_far_ahead(on_street: Callable, other: type) -> None:
    boxes, velocity, there = far_others(
        on_street(
            other(60.0, -4.0, 5.0, heading=0.1),
            other(40.0, 3.0, kind=PEDESTRIAN, size=(0.6, 0.6)),
            other(20.0, 0.0),
            other(-40.0, 0.0),
            other(50.0, 40.0),
        ).view
    )

    assert boxes.shape == (48, 5)
    assert there.sum() == 2
    np.testing.assert_allclose(boxes[0], [40.0 + AXLE, 3.0, 0.0, 0.6, 0.6], atol=1e-4)
    np.testing.assert_allclose(boxes[1, :2], [60.0 + AXLE, -4.0], atol=1e-4)
    np.testing.assert_allclose(velocity[1], [5 * np.cos(0.1), 5 * np.sin(0.1)], atol=1e-5)
    assert not velocity[2:].any()


def test_who_stands_is_where_it_was_half_a_second_ago(on_street: Callable, other: type) -> None:
    view = on_street(other(15.0, 4.0), speed=10.0).view

    now, before = struck(simulated_lidar(view)), struck(simulated_lidar_before(view))
    assert before[:, 0].min() == pytest.approx(now[:, 0].min(), abs=0.3)
    assert before[:, 1].min() == pytest.approx(now[:, 1].min(), abs=0.3)


def test_who_drives_is_where_it_was_half_a_second_ago(on_street: Callable, other: type) -> None:
    view = on_street(other(15.0, 4.0, speed=8.0), speed=10.0).view

    now, before = struck(simulated_lidar(view)), struck(simulated_lidar_before(view))
    assert now[:, 0].min() - before[:, 0].min() == pytest.approx(4.0, abs=0.3)


def test_an_ego_that_turns_sees_who_stands_in_one_place(on_street: Callable, other: type) -> None:
    window = on_street(other(12.0, 4.0), speed=0.0)
    turned = window.view.tracks.copy()
    turned[window.ego, :-3, 2] -= 0.3
    view = replace(window.view, tracks=turned)

    now, before = struck(simulated_lidar(view)), struck(simulated_lidar_before(view))
    assert np.abs(before.mean(0) - now.mean(0)).max() < 0.3


def test_before_it_was_there_the_ego_saw_nothing(on_street: Callable, other: type) -> None:
    window = on_street(other(12.0, 4.0))
    tracks = window.view.tracks.copy()
    tracks[window.ego, :-3] = np.nan

    assert not simulated_lidar_before(replace(window.view, tracks=tracks)).any()
