"""Rule-based drivers, and that none but the record sees what is to come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from anchorflow_driving.drivers import DENSE_TIMES, DRIVERS, PLAN_TIMES, WAYPOINT_TIMES, collides
from anchorflow_driving.log import COMMANDS, DrivingLog
from anchorflow_driving.window import Scenes, Window
from anchorflow_driving.window_choice import command
from anchorflow_trajectory.car.following import idm_acceleration

OnStreet = Callable[..., Window]


@pytest.mark.parametrize("name", DRIVERS)
def test_a_plan_has_a_pose_for_every_time(on_street: OnStreet, name: str) -> None:
    plan = DRIVERS[name](on_street())

    assert plan.shape == (8, 3)
    assert np.isfinite(plan).all()


@pytest.mark.parametrize("name", sorted(set(DRIVERS) - {"human"}))
def test_the_future_changes_no_plan(street: Callable[..., DrivingLog], other, name: str) -> None:
    log = street(other(20.0, 0.0, 6.0), other(10.0, 4.0, 8.0), speed=8.0)
    state = log.track_state.copy()
    state[:, 21:, :2] += 3.0
    state[:, 21:, 2] += 0.3
    state[:, 21:, 3:] *= 0.5

    plan, other_plan = (
        DRIVERS[name](Scenes(each)[0]) for each in (log, replace(log, track_state=state))
    )

    np.testing.assert_array_equal(plan, other_plan)


def test_the_human_replays_the_record(on_street: OnStreet) -> None:
    plan = DRIVERS["human"](on_street(speed=6.0), WAYPOINT_TIMES)

    np.testing.assert_allclose(plan[:, 0], 6 * WAYPOINT_TIMES, atol=1e-5)
    np.testing.assert_allclose(plan[:, 1:], 0, atol=1e-6)


def test_constant_speed_returns_to_the_route(on_street: OnStreet) -> None:
    """The route lies 4 m to the left; the offset is gone after 3 s."""
    route = np.array([[-100.0, 4.0], [200.0, 4.0]], np.float32)
    plan = DRIVERS["route_constant_speed"](on_street(route_points=route))

    np.testing.assert_allclose(plan[:, 0], 10 * PLAN_TIMES, atol=1e-4)
    np.testing.assert_allclose(plan[:, 1], 4 * np.minimum(PLAN_TIMES / 3, 1), atol=1e-4)


def test_stopping_ends_where_the_brakes_say(on_street: OnStreet) -> None:
    plan = DRIVERS["stop"](on_street(speed=6.0))

    assert plan[3:, 0] == pytest.approx(np.full(5, 6.0), abs=1e-4)
    assert plan[0, 0] == pytest.approx(6 * 0.5 - 1.5 * 0.25, abs=1e-4)


def test_idm_keeps_its_distance_from_a_leader(on_street: OnStreet, other) -> None:
    """A standing vehicle in the route's lane, its tail 40 m before the ego's front."""
    window = on_street(other(45.0, 0.0), speed=10.0)

    plan = DRIVERS["idm"](window, DENSE_TIMES)

    axle_to_tail = window.vehicle.rear_axle + 45.0 - 2.5
    assert (np.diff(plan[:, 0]) >= -1e-9).all()
    assert 20 < plan[-1, 0] < axle_to_tail - window.vehicle.rear_axle - 2.5
    assert not np.isfinite(DRIVERS["idm"](window, WAYPOINT_TIMES)[40:]).any()


def test_idm_without_a_leader_goes_to_the_limit(on_street: OnStreet) -> None:
    window = on_street(speed=6.0)

    speed = np.diff(DRIVERS["idm"](window, DENSE_TIMES)[:, 0]) / 0.1

    assert speed[0] < 6.5
    assert 9.5 < speed[-1] < 10.0


def test_idm_rests_at_its_speed_and_at_its_gap() -> None:
    speed, wanted = np.array([10.0, 0.0, 0.0]), np.full(3, 10.0)
    gap = np.array([np.inf, 1.0, np.inf])

    found = idm_acceleration(speed, wanted, gap=gap, leader_speed=np.zeros(3))

    np.testing.assert_allclose(found, [0.0, 0.0, 1.5])


def test_a_view_is_in_the_frame_of_the_rear_axle(on_street: OnStreet, other) -> None:
    view = on_street(other(20.0, 4.0, 3.0, heading=np.pi)).view

    assert view.tracks.shape == (2, 21, 5)
    axle = 0.2823 * 5.0
    np.testing.assert_allclose(view.tracks[0, -1], [axle, 0, 0, 10, 0], atol=1e-5)
    np.testing.assert_allclose(view.tracks[1, -1], [20 + axle, 4, np.pi, -3, 0], atol=1e-5)
    np.testing.assert_allclose(view.tracks[0, 0, 0], axle - 20, atol=1e-5)
    centre, _ = view.polylines("centre")
    np.testing.assert_allclose(centre[0], [-100 + axle, 0], atol=1e-5)


def test_a_window_that_is_not_there(street: Callable[..., DrivingLog]) -> None:
    with pytest.raises(IndexError, match="windows 0 to 0, not 1"):
        Scenes(street())[1]


def test_waypoints_collide_where_boxes_meet(on_street: OnStreet, other) -> None:
    """45 m ahead the front of a box 5 m long; the ego's own reaches 45 + 2.5."""
    waypoints = np.stack([10 * WAYPOINT_TIMES, 0 * WAYPOINT_TIMES], -1)
    reached, missed = (on_street(other(50.0 + gap, 0.0)) for gap in (-0.1, 0.1))

    assert collides(reached, waypoints)
    assert not collides(missed, waypoints)


def bend(degrees: float) -> np.ndarray:
    """20 m straight on, a bend over 10 m, 60 m straight on; a point every 0.25 m."""
    heading = np.deg2rad(degrees) * np.clip((np.arange(0.0, 90.0, 0.25) - 20.0) / 10.0, 0.0, 1.0)
    return np.cumsum(0.25 * np.stack([np.cos(heading), np.sin(heading)], -1), axis=0)


@pytest.mark.parametrize(
    ("degrees", "end", "told"),
    [
        (60.0, 40.0, "left"),
        (-60.0, 40.0, "right"),
        (18.0, 40.0, "straight"),
        (22.0, 40.0, "left"),
        (60.0, 0.0, "straight"),  # stands: 15 m ahead, before the bend
        (60.0, 18.0, "left"),  # 10 m past the recorded end
    ],
)
def test_command(degrees: float, end: float, told: str) -> None:
    assert COMMANDS[command(bend(degrees), 0.0, end)] == told
