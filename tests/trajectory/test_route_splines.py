"""Splines along routes: both ends met, a smooth law of time, tries shared out and told apart."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_trajectory.route_splines import splines_along, spread_round
from anchorflow_trajectory.routes import Route, polyline_length
from anchorflow_trajectory.spline import spline_basis
from anchorflow_trajectory.time_law import time_along

BASIS = spline_basis(64, 8.0)
X_CURR = np.array([-3.0, 0.0, 0.8, 0.3, 0.1, -0.2], np.float32)
X_GOAL = np.array([3.0, 1.0, 0.5, 0.0], np.float32)


def route(*inner: tuple[float, float]) -> Route:
    points = np.array([X_CURR[:2], *inner, X_GOAL[:2]], np.float64)
    return Route(points, polyline_length(points), (len(inner),))


ROUTES = [route(), route((0.0, 2.0)), route((-1.0, -1.5), (1.0, -1.5))]


def test_both_ends_are_met_exactly_whatever_the_route() -> None:
    splines = splines_along(ROUTES, BASIS, x_curr=X_CURR, x_goal=X_GOAL)
    tries = spread_round(splines, BASIS, tries=32, rng=np.random.default_rng(0))
    for control in (splines, tries.control):
        p, v, a = BASIS.states(control)
        start = np.concatenate([p[:, 0], v[:, 0], a[:, 0]], axis=-1)
        goal = np.concatenate([p[:, -1], v[:, -1]], axis=-1)
        np.testing.assert_allclose(start, np.broadcast_to(X_CURR, start.shape), atol=1e-5)
        np.testing.assert_allclose(goal, np.broadcast_to(X_GOAL, goal.shape), atol=1e-5)


def test_a_spline_stays_near_its_route_and_is_no_faster_than_a_cruise() -> None:
    position, velocity, _ = BASIS.states(splines_along(ROUTES, BASIS, x_curr=X_CURR, x_goal=X_GOAL))
    for one, path, speed in zip(ROUTES, position, velocity, strict=True):
        dense = np.stack(
            [
                np.interp(
                    np.linspace(0, len(one.points) - 1, 2000),
                    np.arange(len(one.points)),
                    one.points[:, k],
                )
                for k in (0, 1)
            ],
            -1,
        )
        away = np.linalg.norm(path[:, None] - dense, axis=-1).min(1)
        assert away.max() < 0.3
        assert np.linalg.norm(speed, axis=-1).max() < 1.35 * one.length / 8.0


def test_a_heading_is_that_of_the_smoothest_curve() -> None:
    x_curr = np.array([-3.0, 0, 0.2, 0.8, 0, 0.1, 0, 0, 0], np.float32)
    x_goal = np.array([3.0, 1, 1.0, 0.5, 0, 0], np.float32)
    control = splines_along(ROUTES, BASIS, x_curr=x_curr, x_goal=x_goal)

    assert control.shape == (3, 3, BASIS.num_control_points)
    rest = BASIS.rest_curve(x_curr, x_goal)
    for heading in control[2]:
        np.testing.assert_array_equal(heading, rest[2])
    tries = spread_round(control, BASIS, tries=6, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(tries.control[2], control[2][tries.route])


def test_tries_are_shared_out_and_the_first_of_each_route_is_undisturbed() -> None:
    splines = splines_along(ROUTES, BASIS, x_curr=X_CURR, x_goal=X_GOAL)
    one, same, other = (
        spread_round(splines, BASIS, tries=8, rng=np.random.default_rng(seed)) for seed in (4, 4, 5)
    )

    assert one.route.tolist() == [0, 0, 0, 1, 1, 1, 2, 2]
    np.testing.assert_array_equal(one.control[:, [0, 3, 6]], splines)
    np.testing.assert_array_equal(one.control, same.control)
    disturbed = [1, 2, 4, 5, 7]
    assert (one.control[:, disturbed] != other.control[:, disturbed]).any((0, 2)).all()
    few = spread_round(splines, BASIS, tries=2, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(few.control, splines[:, :2])


def test_the_disturbance_is_as_wide_as_asked_and_least_at_the_ends() -> None:
    splines = splines_along(ROUTES[:1], BASIS, x_curr=X_CURR, x_goal=X_GOAL)
    tries = spread_round(splines, BASIS, tries=2000, rng=np.random.default_rng(0), spread=0.2)
    deviation = (tries.control - splines).std(axis=1)[:, BASIS.free]

    assert deviation.max() == pytest.approx(0.2, rel=0.05)
    assert deviation[:, [0, -1]].max() < 0.5 * deviation.max()


def test_without_a_route_there_is_nothing_to_follow() -> None:
    with pytest.raises(ValueError, match="expected at least one route, got none"):
        splines_along([], BASIS, x_curr=X_CURR, x_goal=X_GOAL)
    splines = splines_along(ROUTES, BASIS, x_curr=X_CURR, x_goal=X_GOAL)
    with pytest.raises(ValueError, match="got 0 and 3 routes"):
        spread_round(splines, BASIS, tries=0, rng=np.random.default_rng(0))


def test_a_route_to_where_one_stands_stands_still() -> None:
    here = np.array([[1.0, 2.0], [1.0, 2.0]])
    x_curr, x_goal = np.array([1, 2, 0, 0, 0, 0.0]), np.array([1, 2, 0, 0.0])
    control = splines_along([Route(here, 0.0, ())], BASIS, x_curr=x_curr, x_goal=x_goal)
    np.testing.assert_allclose(control[:, 0].T - [1.0, 2.0], 0.0, atol=1e-5)


@pytest.mark.parametrize(("first", "last"), [(0.0, 0.0), (0.6, 0.0), (0.0, 0.9), (1.3, 0.2)])
def test_the_law_of_time_has_the_speeds_that_are_asked_and_a_cruise_between(
    first: float, last: float
) -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0]])
    x = time_along(line, 4001, start_share=first, goal_share=last)[:, 0].astype(np.float64)
    speed = np.diff(x) * 4000 / 10.0  # in shares of the mean

    assert (x[0], x[-1]) == (0.0, 10.0)
    assert speed[:20].mean() == pytest.approx(first, abs=0.02)
    assert speed[-20:].mean() == pytest.approx(last, abs=0.02)
    cruise = (1.0 - 0.09 * (first + last)) / 0.82
    assert speed[800:3200].mean() == pytest.approx(cruise, abs=0.01)


def test_a_law_of_time_that_leaves_nothing_to_the_cruise_never_turns_back() -> None:
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    x = time_along(line, 401, start_share=9.0, goal_share=9.0)[:, 0]

    assert (np.diff(x) >= 0.0).all()
    assert (x[0], x[-1]) == (0.0, 1.0)


def test_a_robot_that_is_on_its_way_and_is_to_pass_the_goal_keeps_its_speed() -> None:
    x_curr = np.array([-3.0, 1.0, 0.75, 0, 0, 0], np.float32)
    x_goal = np.array([3.0, 1.0, 0.75, 0], np.float32)
    line = Route(np.array([[-3.0, 1.0], [3.0, 1.0]]), 6.0, ())
    _, velocity, _ = BASIS.states(splines_along([line], BASIS, x_curr=x_curr, x_goal=x_goal))

    np.testing.assert_allclose(velocity[0], np.tile([0.75, 0.0], (64, 1)), atol=1e-3)
