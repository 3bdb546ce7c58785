"""Splines along routes: both ends met, a smooth law of time, tries shared out and told apart."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_trajectory.motion import MotionLimits, nominal_duration
from anchorflow_trajectory.routes.search import Route, polyline_length
from anchorflow_trajectory.routes.splines import (
    LEAST_SPREAD,
    MOST_SPREAD,
    PACES,
    splines_along,
    spread_round,
    usual_spread,
)
from anchorflow_trajectory.spline.basis import Ends, Splines, spline_basis

BASIS = spline_basis(64)
LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
HORIZON = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=8.0)
X_CURR = np.array([-3.0, 0.0, 0.8, 0.3, 0.1, -0.2], np.float32)
X_GOAL = np.array([3.0, 1.0, 0.5, 0.0], np.float32)
ENDS = Ends(X_CURR, X_GOAL)


def route(*inner: tuple[float, float]) -> Route:
    points = np.array([X_CURR[:2], *inner, X_GOAL[:2]], np.float64)
    return Route(points, polyline_length(points), (len(inner),))


ROUTES = [route(), route((0.0, 2.0)), route((-1.0, -1.5), (1.0, -1.5))]


@pytest.mark.parametrize("limits", [LIMITS, HORIZON])
def test_both_ends_are_met_exactly_whatever_the_route(limits: MotionLimits) -> None:
    splines = splines_along(ROUTES, BASIS, ENDS, limits=limits)
    tries = spread_round(splines, BASIS, tries=32, rng=np.random.default_rng(0), spread=0.3)
    p, v, a = BASIS.states(splines)
    start = np.concatenate([p[:, 0], v[:, 0], a[:, 0]], axis=-1)
    goal = np.concatenate([p[:, -1], v[:, -1]], axis=-1)
    np.testing.assert_allclose(start, np.broadcast_to(X_CURR, start.shape), atol=1e-4)
    np.testing.assert_allclose(goal, np.broadcast_to(X_GOAL, goal.shape), atol=1e-5)
    # A try keeps its route's control points at the ends, and the finish meets them in its time.
    fixed = np.r_[0:3, -2:0]
    np.testing.assert_array_equal(
        tries.splines.control[..., fixed], splines.control[:, tries.route][..., fixed]
    )


def test_a_route_lasts_as_long_as_the_limits_and_the_style_make_it() -> None:
    lengths = [one.length for one in ROUTES]
    plain = splines_along(ROUTES, BASIS, ENDS, limits=LIMITS)
    assert plain.duration.tolist() == [nominal_duration(x, LIMITS) for x in lengths]
    for leaning in np.eye(3):
        pace = float(PACES @ leaning)
        styled = splines_along(ROUTES, BASIS, ENDS, limits=LIMITS, leaning=leaning)
        assert styled.duration.tolist() == [nominal_duration(x, LIMITS, pace=pace) for x in lengths]
    assert splines_along(ROUTES, BASIS, ENDS, limits=HORIZON).duration.tolist() == [8.0] * 3


def test_a_slower_robot_takes_the_same_ways_in_longer() -> None:
    """v_max / 2, a_max / 4 and the ends' speeds / 2: the same control points in twice the time."""
    slow = MotionLimits(v_max=1.0, a_max=0.75)
    ends = Ends(X_CURR / np.repeat([1.0, 2.0, 4.0], 2), X_GOAL / np.repeat([1.0, 2.0], 2))
    splines = splines_along(ROUTES, BASIS, ENDS, limits=LIMITS)
    slower = splines_along(ROUTES, BASIS, ends, limits=slow)
    np.testing.assert_allclose(slower.duration, 2.0 * splines.duration, rtol=1e-9)
    np.testing.assert_allclose(slower.control, splines.control, atol=1e-5)


def test_a_spline_stays_near_its_route_and_is_no_faster_than_a_cruise() -> None:
    splines = splines_along(ROUTES, BASIS, ENDS, limits=HORIZON)
    position, velocity, _ = BASIS.states(splines)
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


def test_splines_along_straight_routes_keep_the_limits() -> None:
    """On straight routes a descent begins within the limits."""
    for limits in (LIMITS, MotionLimits(v_max=0.5, a_max=0.25), MotionLimits(v_max=6.0, a_max=3.0)):
        for length in (0.5, 2.0, 6.0, 20.0):
            ends = Ends(np.zeros(6), np.array([length, 0.0, 0.0, 0.0]))
            line = Route(np.array([[0.0, 0.0], [length, 0.0]]), length, ())
            states = BASIS.states(splines_along([line], BASIS, ends, limits=limits))
            fastest, hardest = (np.linalg.norm(x[0], axis=-1).max() for x in states[1:])
            assert fastest <= 1.05 * limits.v_max
            assert hardest <= 1.1 * limits.a_max
            assert fastest > 0.8 * limits.v_max or hardest > 0.8 * limits.a_max


def test_a_heading_is_that_of_the_smoothest_curve() -> None:
    ends = Ends(
        np.array([-3.0, 0, 0.2, 0.8, 0, 0.1, 0, 0, 0], np.float32),
        np.array([3.0, 1, 1.0, 0.5, 0, 0], np.float32),
    )
    splines = splines_along(ROUTES, BASIS, ends, limits=LIMITS)

    assert splines.control.shape == (3, 3, BASIS.num_control_points)
    rest = BASIS.rest_curves(ends, splines.duration)
    np.testing.assert_array_equal(splines.control[2], rest.control[2])
    tries = spread_round(splines, BASIS, tries=6, rng=np.random.default_rng(0), spread=0.2)
    np.testing.assert_array_equal(tries.splines.control[2], splines.control[2][tries.route])


def test_tries_are_dealt_out_in_turn_and_the_first_of_each_route_is_undisturbed() -> None:
    splines = splines_along(ROUTES, BASIS, ENDS, limits=LIMITS)
    one, same, other = (
        spread_round(splines, BASIS, tries=8, rng=np.random.default_rng(seed), spread=0.2)
        for seed in (4, 4, 5)
    )

    assert one.route.tolist() == [0, 1, 2, 0, 1, 2, 0, 1]
    assert_same(one.splines[:3], splines)
    assert not one.disturbance[:3].any()
    assert_same(one.splines, same.splines)
    control, duration = one.splines.control, one.splines.duration
    assert (control[:, 3:] != other.splines.control[:, 3:]).any((0, 2)).all()
    assert (duration[3:] != other.splines.duration[3:]).all()
    few = spread_round(splines, BASIS, tries=2, rng=np.random.default_rng(0), spread=0.2)
    assert_same(few.splines, splines[:2])


def assert_same(one: Splines, other: Splines) -> None:
    np.testing.assert_array_equal(one.control, other.control)
    np.testing.assert_array_equal(one.duration, other.duration)


@pytest.mark.parametrize("stretch", [0.0, 0.1])
def test_the_disturbance_is_what_a_try_differs_by_from_its_route(stretch: float) -> None:
    splines = splines_along(ROUTES, BASIS, ENDS, limits=LIMITS)
    tries = spread_round(
        splines, BASIS, tries=64, rng=np.random.default_rng(0), spread=0.2, stretch=stretch
    )
    points = (tries.splines.control - splines.control[:, tries.route])[..., BASIS.free]
    told = tries.disturbance[:, :-1].reshape(64, 2, -1).swapaxes(0, 1)
    np.testing.assert_allclose(told, points, atol=1e-6)
    longer = np.log(tries.splines.duration / splines.duration[tries.route])
    np.testing.assert_allclose(tries.disturbance[:, -1], longer, atol=1e-6)
    assert longer.std() == pytest.approx(stretch, rel=0.25)


def test_the_disturbance_is_as_wide_as_asked_and_least_at_the_ends() -> None:
    splines = splines_along(ROUTES[:1], BASIS, ENDS, limits=LIMITS)
    tries = spread_round(splines, BASIS, tries=2000, rng=np.random.default_rng(0), spread=0.2)
    deviation = (tries.splines.control - splines.control).std(axis=1)[:, BASIS.free]

    assert deviation.max() == pytest.approx(0.2, rel=0.05)
    assert deviation[:, [0, -1]].max() < 0.5 * deviation.max()


def test_the_usual_spread_is_a_share_of_the_straight_way_within_bounds() -> None:
    def spread(way: float) -> float:
        return usual_spread(Ends(np.zeros(6), np.array([0.6 * way, 0.8 * way, 0.0, 0.0])))

    assert spread(0.5) == LEAST_SPREAD
    assert spread(4.0) == pytest.approx(0.2)
    assert spread(50.0) == MOST_SPREAD


def test_without_a_route_there_is_nothing_to_follow() -> None:
    with pytest.raises(ValueError, match="expected at least one route, got none"):
        splines_along([], BASIS, ENDS, limits=LIMITS)
    splines = splines_along(ROUTES, BASIS, ENDS, limits=LIMITS)
    with pytest.raises(ValueError, match="got 0 and 3 routes"):
        spread_round(splines, BASIS, tries=0, rng=np.random.default_rng(0), spread=0.2)


def test_a_route_to_where_one_stands_stands_still() -> None:
    here = Route(np.array([[1.0, 2.0], [1.0, 2.0]]), 0.0, ())
    ends = Ends(np.array([1, 2, 0, 0, 0, 0.0]), np.array([1, 2, 0, 0.0]))
    splines = splines_along([here], BASIS, ends, limits=LIMITS)
    np.testing.assert_allclose(splines.control[:, 0].T - [1.0, 2.0], 0.0, atol=1e-5)
    assert 0.0 < splines.duration[0] < 1.0


def test_a_robot_that_is_on_its_way_and_is_to_pass_the_goal_keeps_its_speed() -> None:
    ends = Ends(np.array([-3.0, 1.0, 0.75, 0, 0, 0]), np.array([3.0, 1.0, 0.75, 0]))
    line = Route(np.array([[-3.0, 1.0], [3.0, 1.0]]), 6.0, ())
    _, velocity, _ = BASIS.states(splines_along([line], BASIS, ends, limits=HORIZON))

    np.testing.assert_allclose(velocity[0], np.tile([0.75, 0.0], (64, 1)), atol=1e-3)
