"""One scene: fields derived from its map, when they are computed, and the inputs of a network."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from anchorflow_trajectory.cost import clearance
from anchorflow_trajectory.cost.fields import soft_cost
from anchorflow_trajectory.cost.trajectory_cost import CostWeights
from anchorflow_trajectory.ending import among_movers
from anchorflow_trajectory.motion import MotionLimits, share_within
from anchorflow_trajectory.movers import MovingDiscs
from anchorflow_trajectory.routes.splines import LEAST_WAY, splines_along
from anchorflow_trajectory.scene import SCENE_INPUTS, Scene


@pytest.fixture
def scene() -> Scene:
    """4 x 3 m from (1, 2) with a wall that has one gap, its occupancy on either side of 0.5."""
    occupancy = np.zeros((1, 30, 40), np.float32)
    occupancy[0, :24, 18:21], occupancy[0, 0, 0] = 0.5, 0.49
    return Scene(
        cost_map=occupancy,
        resolution=0.1,
        origin=np.array([1.0, 2.0]),
        robot_radius=0.2,
        x_curr=np.array([1.5, 3.0, 0.1, 0.2, 0.3, 0.4]),
        x_goal=np.array([4.5, 3.0, 0.0, 0.0]),
        w_style=np.array([0.4, 0.3, 0.3]),
        motion=MotionLimits(v_max=2.0, a_max=3.0),
    )


def test_fields_follow_from_the_map(scene: Scene) -> None:
    assert scene.occupied.sum() == 24 * 3
    field = clearance.clearance_field(scene.occupied, 0.1, 0.2)
    np.testing.assert_array_equal(scene.clearance_field, field)
    assert scene.map_geometry.tolist() == pytest.approx([1.0, 2.0, 0.1])
    np.testing.assert_array_equal(scene.cost_fields.clearance.values, field)
    assert scene.cost_fields.surcharge is not None


def test_routes_that_cannot_keep_the_certified_margin_are_not_offered(scene: Scene) -> None:
    occupancy = scene.cost_map.copy()
    occupancy[0, 8:14, 18:21] = 0.0  # a door of 0.6 m, straight ahead
    by_door = replace(scene, cost_map=occupancy)
    round_the_end = replace(by_door, certified_margin=0.09)
    nobody_has_it = replace(by_door, certified_margin=1.0)

    assert [route.points[:, 1].max() < 3.2 for route in by_door.routes] == [True]
    assert [route.points[:, 1].max() > 4.4 for route in round_the_end.routes] == [True]
    assert len(nobody_has_it.routes) == 1  # offered all the same, and called unsafe


def test_routes_keep_the_certified_margin_when_they_are_pulled_tight(scene: Scene) -> None:
    low = scene.cost_map.copy()
    low[0, 12:24, 18:21] = 0.0  # 1.8 m are left above the wall
    (route,) = replace(scene, cost_map=low, certified_margin=0.3).routes
    field = replace(scene, cost_map=low).clearance_field
    legs = [np.linspace(a, b, 50) for a, b in pairwise(route.points)]
    cells = ((np.concatenate(legs) - scene.origin) / scene.resolution).astype(int)
    assert field[cells[:, 1], cells[:, 0]].min() >= 0.3


def test_the_routes_lead_through_the_gap_and_durations_are_measured_by_the_first(
    scene: Scene,
) -> None:
    lengths = [route.length for route in scene.routes]
    assert lengths == sorted(lengths)
    assert lengths[0] > 3.5  # the straight way is 3 m long and barred
    assert scene.reference_s == scene.motion.least_time(lengths[0])
    states = scene.route_states
    assert (states.shape, states.dtype) == ((len(lengths), 64, 7), np.float32)
    at_wall = np.abs(states[0, :, 0] - 2.95).argmin()
    assert states[0, at_wall, 1] > 4.4
    splines = splines_along(
        scene.routes,
        scene.basis,
        scene.ends,
        limits=scene.motion,
        leaning=CostWeights().leaning(scene.w_style),
    )
    np.testing.assert_array_equal(states[..., :6], scene.basis.own_time_states(splines.control))
    lasting = np.log(splines.duration)[:, None]
    np.testing.assert_allclose(states[..., 6], np.broadcast_to(lasting, (len(lengths), 64)))
    # Its velocity is p' over the duration, so the start's is met.
    first = states[:, 0, 2:4] / splines.duration[:, None]
    np.testing.assert_allclose(first, np.tile([0.1, 0.2], (len(lengths), 1)), atol=1e-5)


def test_where_no_way_is_free_the_straight_one_is_followed(scene: Scene) -> None:
    closed = scene.cost_map.copy()
    closed[0, :, 18:21] = 1.0
    barred = replace(scene, cost_map=closed)
    assert barred.routes == []
    assert barred.reference_s == scene.motion.least_time(3.0)
    assert len(barred.route_splines) == 1
    assert np.ptp(barred.route_states[0, :, 1]) < 0.2


def test_a_goal_underfoot_is_measured_by_the_least_way(scene: Scene) -> None:
    near = replace(scene, x_goal=np.array([1.5, 3.0, 0.0, 0.0]))
    assert near.reference_s == scene.motion.least_time(LEAST_WAY)


def test_limits_tell_a_horizon_or_that_there_is_none(scene: Scene) -> None:
    np.testing.assert_allclose(scene.limits, [2.0, 3.0, 0.2, 0.0])
    fixed = replace(scene, motion=MotionLimits(1.0, 2.0, horizon_s=7.0))
    np.testing.assert_allclose(fixed.limits, [1.0, 2.0, 0.2, 7.0])
    np.testing.assert_allclose(fixed.route_states[..., -1], np.log(7.0), rtol=1e-6)
    assert fixed.route_splines.duration.tolist() == [7.0] * len(fixed.routes)


def test_a_slower_robot_sees_the_same_routes_for_longer(scene: Scene) -> None:
    slow = replace(
        scene,
        x_curr=scene.x_curr / np.repeat([1.0, 2.0, 4.0], 2),
        motion=MotionLimits(v_max=1.0, a_max=0.75),
    )
    assert slow.reference_s == pytest.approx(2.0 * scene.reference_s)
    longer = slow.route_states - scene.route_states
    np.testing.assert_allclose(longer[..., :-1], 0.0, atol=1e-4)
    np.testing.assert_allclose(longer[..., -1], np.log(2.0), atol=1e-5)


def test_what_moves_makes_a_narrow_gap_worth_a_detour(scene: Scene) -> None:
    occupancy = scene.cost_map.copy()
    occupancy[0, 10:15, 18:21] = 0.0  # 0.5 m wide; the robot 0.3 m
    start, goal = np.array([1.5, 3.6, 0, 0, 0, 0]), np.array([4.5, 3.6, 0, 0])
    narrow = replace(scene, cost_map=occupancy, robot_radius=0.15, x_curr=start, x_goal=goal)
    aside = MovingDiscs.of(np.array([[9.0, 9.0]]), np.zeros((1, 2)), np.array([0.1]))
    through, past = narrow.routes[0], replace(narrow, movers=aside).routes[0]
    assert through.length < 3.2 < past.length

    hurried = replace(narrow.motion, horizon_s=2.0)  # in which the detour cannot be driven
    assert replace(narrow, movers=aside, motion=hurried).routes[0].length < 3.2


@pytest.mark.parametrize(("speed", "stays"), [(1.3, True), (0.0, False)])
def test_a_goal_is_clear_if_who_is_there_goes_on_before_another_comes(
    scene: Scene, speed: float, stays: bool
) -> None:
    """One comes from behind and is 0.3 m behind the goal 0.3 s after the robot."""
    occupancy, goal = np.zeros_like(scene.cost_map), np.array([4.5, 3.5, speed, 0.0])
    behind = MovingDiscs.of(np.array([[-2.25, 3.5]]), np.array([[1.5, 0.0]]), np.array([0.2]))
    motion = replace(scene.motion, horizon_s=4.0)
    free = replace(scene, cost_map=occupancy, x_goal=goal, motion=motion, movers=behind)
    assert np.array_equal(among_movers(free).x_goal, goal) == stays


@pytest.mark.parametrize("horizon_s", [None, 4.0])
def test_a_goal_that_moves_aside_keeps_its_velocity(scene: Scene, horizon_s: float | None) -> None:
    occupancy, goal = np.zeros_like(scene.cost_map), np.array([4.5, 3.5, 1.3, 0.0])
    taken = MovingDiscs.of(goal[None, :2], np.zeros((1, 2)), np.array([0.2]))
    motion = replace(scene.motion, horizon_s=horizon_s)
    free = replace(scene, cost_map=occupancy, x_goal=goal, motion=motion, movers=taken)
    moved = among_movers(free).x_goal
    assert not np.array_equal(moved[:2], goal[:2])
    np.testing.assert_array_equal(moved[2:], goal[2:])


@pytest.mark.parametrize(("apart", "touched"), [(0.39, True), (0.41, False)])
def test_a_start_is_touched_within_both_radii(scene: Scene, apart: float, touched: bool) -> None:
    place = scene.x_curr[None, :2] + [[0.0, apart]]
    near = MovingDiscs.of(place, np.zeros((1, 2)), np.array([0.2]))
    free = replace(scene, cost_map=np.zeros_like(scene.cost_map), movers=near)
    assert free.is_touched == touched


def test_inputs_are_float32_with_a_batch_axis(scene: Scene) -> None:
    inputs = scene.inputs(SCENE_INPUTS)
    routes = len(scene.routes)
    assert tuple(inputs) == SCENE_INPUTS
    assert {array.dtype for array in inputs.values()} == {np.dtype(np.float32)}
    assert {name: array.shape for name, array in inputs.items()} == {
        "cost_map": (1, 3, 30, 40),
        "map_geometry": (1, 3),
        "clearance_field": (1, 30, 40),
        "x_curr": (1, 6),
        "x_goal": (1, 4),
        "w_style": (1, 3),
        "limits": (1, 4),
        "route_states": (1, routes, 64, 7),
    }
    assert list(scene.inputs(["x_goal"])) == ["x_goal"]


def test_the_soft_cost_is_the_largest_of_the_layers_and_obstacles_have_none() -> None:
    layers = np.zeros((4, 1, 6), np.float32)
    layers[0, 0] = [0.0, 0.45, 0.5, 0.0, 0.0, 1e-40]
    layers[1, 0] = [1.0, 1.0, 1.0, 0.8, 1.0, 1.0]
    layers[2, 0] = [0.0, 0.0, 0.0, 0.1, 0.3, 0.0]
    layers[3, 0] = [0.0, 0.0, 0.0, 0.0, 0.4, 0.0]

    even = soft_cost(layers)
    weighted = soft_cost(layers, np.array([1.0, 2.0, 0.5]))

    np.testing.assert_allclose(even, [[0.0, 0.9, 0.0, 0.2, 0.4, 0.0]], atol=1e-6)
    np.testing.assert_allclose(weighted, [[0.0, 0.9, 0.0, 0.2, 0.6, 0.0]], atol=1e-6)
    assert even[0, 5] == 0.0
    assert soft_cost(10.0 * layers[2:3]).max() <= 1.0


def test_a_penalty_of_zero_is_even_ground_and_networks_see_the_surcharge(scene: Scene) -> None:
    risky = np.stack([scene.occupied, *np.full((2, 30, 40), [[[1.0]], [[0.5]]])]).astype(np.float32)
    dear, even = (replace(scene, cost_map=risky, cost_penalty=p) for p in (6.0, 0.0))

    assert even.surcharge is None
    assert dear.surcharge is not None
    assert dear.surcharge.max() == 3.0
    assert dear.network_map[:, -1, -1].tolist() == [0.0, 1.0, 0.5]
    assert even.network_map[:, -1, -1].tolist() == [0.0, 1.0, 0.0]
    assert [route.cost for route in even.routes] == [route.length for route in even.routes]
    assert dear.routes[0].cost == pytest.approx(4.0 * dear.routes[0].length)


def test_an_acceleration_that_would_pass_the_speed_is_eased(scene: Scene) -> None:
    slow = replace(
        scene,
        x_curr=np.array([1.5, 3.0, 0.2, 0.0, 0.2, 0.0]),
        motion=MotionLimits(v_max=0.26, a_max=1.0),
    )
    eased = slow.ends.x_curr
    assert eased[:4].tolist() == slow.x_curr[:4].tolist()
    assert 0.02 < eased[4] < 0.15
    assert eased[5] == 0.0
    # Braking as hard, or with the speed to spare, it stays what it is.
    for x_curr, v_max in (([0.2, 0.0, -0.2, 0.0], 0.26), ([0.2, 0.0, 0.2, 0.0], 2.0)):
        other = replace(
            slow,
            x_curr=np.array([1.5, 3.0, *x_curr]),
            motion=MotionLimits(v_max=v_max, a_max=1.0),
        )
        assert other.ends.x_curr.tolist() == other.x_curr.tolist()


@pytest.mark.parametrize("most", [1.0, 1.5])
def test_the_share_just_reaches_the_greatest_length(most: float) -> None:
    velocity, gained = np.array([0.6, 0.0]), np.array([1.0, 2.0])
    share = share_within(velocity, gained, most)
    assert 0.0 < share < 1.0
    assert np.linalg.norm(velocity + share * gained) == pytest.approx(most)
    assert share_within(velocity, gained, 9.0) == 1.0
    assert share_within(velocity, -gained / 10, 0.6) == 1.0
    assert share_within(velocity, gained, 0.6) == 0.0
