"""The controller in the loop: walls, what moves, dear ground, limits, braking, commitment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from analytic_anchors import batch_of, straight
from driven_robot import Drive, drive, square_map

from anchorflow_client import CostMap, InvalidRequest, Plan, PlanState
from anchorflow_control import MppiConfig, MppiController, Robot

SMALL = MppiConfig(motions=256, steps=30)
WALL = square_map((slice(40, 60), slice(48, 52)))  # 2 m wide, across the straight way
EMPTY = square_map()
START, GOAL = [-3.0, 0.0, 0.0, 0.0, 0.0], [3.0, 0.2]


def cross(robot: Robot, *, ticks: int = 170, seed: int = 0, **given: Any) -> Drive:
    """Drive from the left to the right of a map; `given` replaces arguments of each command."""
    controller = MppiController(robot, SMALL, tick_s=0.05, seed=seed)
    told = {"cost_map": WALL, "goal": GOAL} | given
    return drive(controller, START, ticks=ticks, at_tick=lambda *_: told)


def round_the_wall() -> Any:
    """Return anchors below and above the wall, the first of them the better one."""
    ways = ([-0.1, -1.7], [-0.1, 1.8])
    anchors = [straight(START[:2], way, GOAL, seconds=11.0, steps=64) for way in ways]
    return batch_of(
        *anchors,
        dt=11.0 / 63,
        scores=np.array([-1.0, -2.0]),
        safe=np.ones(2, bool),
        routes=np.array([0, 1]),
    )


def wall_distance(places: np.ndarray) -> np.ndarray:
    """Return m to the wall of WALL."""
    out = np.maximum(np.abs(places - [0.0, 0.0]) - [0.2, 1.0], 0.0)
    return np.linalg.norm(out, axis=1)


def test_along_anchors_it_passes_a_wall_and_stops_at_the_goal(robot: Robot) -> None:
    controller = MppiController(robot, SMALL, tick_s=0.05)
    batch = round_the_wall()
    driven = drive(
        controller,
        START,
        ticks=240,
        at_tick=lambda tick, _: {"cost_map": WALL, "goal": GOAL, "anchors": aged(batch, tick)},
    )

    assert wall_distance(driven.places).min() > robot.reach
    assert np.linalg.norm(driven.places[-1] - GOAL) < 0.15
    assert np.linalg.norm(driven.states[-20:, 3], axis=0) < 0.1
    assert not any(command.braking for command in driven.commands)


def test_alone_it_passes_a_wall_that_it_sees_round(robot: Robot) -> None:
    controller = MppiController(robot, tick_s=0.05)
    told = {"cost_map": WALL, "goal": GOAL}
    driven = drive(controller, START, ticks=200, at_tick=lambda *_: told)

    assert wall_distance(driven.places).min() > robot.reach
    assert np.linalg.norm(driven.places[-1] - GOAL) < 0.15


def test_commands_keep_the_limits(robot: Robot) -> None:
    driven = cross(robot, ticks=80)
    first, second = driven.states[:, 3:].T
    change = np.abs(np.diff(driven.states[:, 3:], axis=0)) / 0.05
    if robot.is_omni:
        assert np.hypot(first, second).max() <= robot.v_max + 1e-4
        assert np.linalg.norm(change, axis=1).max() <= robot.a_max + 1e-3
        return
    assert first.min() >= -1e-6
    assert first.max() <= robot.v_max + 1e-4
    assert change[:, 0].max() <= robot.a_max + 1e-3
    assert np.abs(second).max() <= robot.omega_max + 1e-4
    assert np.abs(first * second).max() <= robot.a_max + 1e-3
    assert (np.abs(second) * robot.min_turning_radius <= np.abs(first) + 1e-4).all()


def test_the_predicted_motion_begins_with_the_command(robot: Robot) -> None:
    command = cross(robot, ticks=20).commands[-1]

    assert command.motion.shape == (30, 3)
    np.testing.assert_allclose(command.times, 0.1 * np.arange(1, 31))
    assert np.linalg.norm(np.diff(command.motion[:, :2], axis=0), axis=1).max() < 0.11
    speed = np.linalg.norm(command.motion[0, :2] - command.motion[1, :2]) / 0.1
    u = np.linalg.norm(command.u) if robot.is_omni else command.u[0]
    assert speed == pytest.approx(u, abs=0.25)


def test_a_speed_limit_slows_it_down(robot: Robot) -> None:
    driven = cross(robot, ticks=60, cost_map=EMPTY, speed_limit=0.4)
    speed = np.linalg.norm(driven.states[:, 3 : 5 if robot.is_omni else 4], axis=1)
    assert 0.35 < speed.max() <= 0.4 + 1e-4


def test_the_twist_of_a_robot_that_moves_sideways_is_in_its_own_frame() -> None:
    robot = Robot(kind="omni", v_max=1.0, a_max=1.5, radius=0.3)
    controller = MppiController(robot, SMALL)
    state = [0.0, 0.0, np.pi / 2, 0.0, 0.5]
    command = controller.command(state, cost_map=EMPTY, goal=[0.0, 4.0])

    assert command.u[1] > 0.5
    np.testing.assert_allclose(command.twist, [command.u[1], -command.u[0], 0.0], atol=1e-9)


def test_it_waits_for_or_passes_somebody_who_crosses(robot: Robot) -> None:
    person = np.array([0.0, 2.2]), np.array([0.0, -0.6])

    def at_tick(tick: int, _: np.ndarray) -> dict[str, Any]:
        now = person[0] + 0.05 * tick * person[1]
        told = {"position": [now], "velocity": [person[1]], "radius": [0.3]}
        return {"cost_map": EMPTY, "goal": GOAL, "obstacles": told}

    def met(obstacles: bool) -> float:
        controller = MppiController(robot, SMALL, tick_s=0.05)
        driven = drive(
            controller,
            START,
            ticks=140,
            at_tick=lambda *now: at_tick(*now) | ({} if obstacles else {"obstacles": None}),
        )
        people = person[0] + 0.05 * np.arange(141)[:, None] * person[1]
        assert np.linalg.norm(driven.places[-1] - GOAL) < 1.0
        return float(np.linalg.norm(driven.places - people, axis=1).min()) - 0.6

    assert met(obstacles=True) > 0.0
    assert met(obstacles=False) < 0.0  # who is not told of collides


def test_it_goes_round_dear_ground() -> None:
    robot = Robot(kind="omni", v_max=1.0, a_max=1.5, radius=0.3)
    dear = np.zeros((3, 100, 100), np.float32)
    dear[1], dear[2, 44:56, 40:60] = 1.0, 0.8
    ground = CostMap.build(dear, 0.1)

    def most_dear(cost_map: CostMap, penalty: float) -> float:
        controller = MppiController(robot, MppiConfig(motions=512, cost_penalty=penalty))
        told = {"cost_map": cost_map, "goal": [3.0, 0.0]}
        driven = drive(controller, [-3.0, 0.2, 0.0, 0.0, 0.0], ticks=160, at_tick=lambda *_: told)
        assert driven.places[-1, 0] > 2.0
        inside = (np.abs(driven.places) < [1.0, 0.6]).all(1)
        return float(inside.mean())

    assert most_dear(ground, 0.0) > 0.2
    assert most_dear(ground, 3.0) < 0.02


def test_along_anchors_it_drives_over_ground_that_is_dear_everywhere(robot: Robot) -> None:
    """As in Nav2's inflation, where there is no cheaper way: it must not stand still."""
    dear = np.zeros((3, 100, 100), np.float32)
    dear[1], dear[2] = 1.0, 0.9
    ground = CostMap.build(dear, 0.1)
    batch = batch_of(
        straight(START[:2], GOAL, seconds=9.0, steps=64),
        dt=9.0 / 63,
        scores=np.zeros(1),
        safe=np.ones(1, bool),
        routes=np.zeros(1, int),
    )
    driven = drive(
        MppiController(robot, SMALL, tick_s=0.05),
        START,
        ticks=220,
        at_tick=lambda tick, _: {"cost_map": ground, "goal": GOAL, "anchors": aged(batch, tick)},
    )
    assert np.linalg.norm(driven.places[-1] - GOAL) < 0.3


def test_a_footprint_passes_where_its_circle_would_not() -> None:
    """An aisle of 1.1 m for a cart of 0.9 x 0.62 m, whose circle is 1.09 m wide with margins."""
    aisle = square_map((slice(0, 44), slice(30, 70)), (slice(56, 100), slice(30, 70)))
    cart = [[0.45, 0.31], [-0.45, 0.31], [-0.45, -0.31], [0.45, -0.31]]
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, footprint=cart)
    driven = drive(
        MppiController(robot, SMALL, tick_s=0.05),
        [-3.5, 0.3, 0.0, 0.0, 0.0],
        ticks=220,
        at_tick=lambda *_: {"cost_map": aisle, "goal": [3.5, 0.0]},
    )
    cos, sin = np.cos(driven.states[:, 2]), np.sin(driven.states[:, 2])
    corners = np.array(cart)
    x = driven.places[:, :1] + cos[:, None] * corners[:, 0] - sin[:, None] * corners[:, 1]
    y = driven.places[:, 1:] + sin[:, None] * corners[:, 0] + cos[:, None] * corners[:, 1]

    assert np.abs(y[np.abs(x) < 2.0]).max() < 0.6
    assert driven.places[-1, 0] > 3.0


def test_it_follows_the_better_anchor_and_says_which() -> None:
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, radius=0.3)
    batch = round_the_wall()
    command = MppiController(robot, SMALL, tick_s=0.05).command(
        START, cost_map=WALL, goal=GOAL, anchors=batch
    )
    assert command.anchor in (0, 1)
    assert not command.braking

    # A wall closes one side: the other anchor is followed, whatever its score.
    for closed, open_side in ((slice(0, 50), 1), (slice(50, 100), 0)):
        shut = square_map((slice(40, 60), slice(48, 52)), (closed, slice(48, 52)))
        controller = MppiController(robot, SMALL, tick_s=0.05)
        told = {"cost_map": shut, "goal": GOAL, "anchors": batch}
        driven = drive(controller, START, ticks=30, at_tick=lambda *_, told=told: told)
        assert driven.commands[-1].anchor == open_side
        assert np.sign(driven.commands[-1].motion[-1, 1]) == (1 if open_side else -1)


def test_with_anchors_it_leaves_a_pocket_that_mppi_alone_stays_in() -> None:
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, radius=0.3)
    pocket = square_map(
        (slice(25, 75), slice(60, 64)),
        (slice(25, 29), slice(40, 64)),
        (slice(71, 75), slice(40, 64)),
    )
    state = [-0.5, 0.0, 0.0, 0.0, 0.0]
    way = straight(
        state[:2], [-1.8, 0.0], [-1.8, -3.3], [2.5, -3.3], [3.5, 0.0], seconds=22.0, steps=120
    )

    def end(anchors: Any) -> np.ndarray:
        controller = MppiController(robot, SMALL, tick_s=0.05)
        driven = drive(
            controller,
            state,
            ticks=480,
            at_tick=lambda tick, _: {
                "cost_map": pocket,
                "goal": [3.5, 0.0],
                "anchors": None if anchors is None else aged(anchors, tick),
            },
        )
        return driven.places[-1]

    assert end(None)[0] < 1.0
    assert np.linalg.norm(end(batch_of(way, dt=22.0 / 119)) - [3.5, 0.0]) < 0.5


def aged(batch: Any, tick: int) -> Plan:
    """Return a plan that follows the first anchor, from ticks ago."""
    count = len(batch.trajectories)
    return Plan(
        PlanState.FRESH, batch=batch, age_ms=50.0 * tick, best=0, on_route=np.arange(count) == 0
    )


def test_without_a_usable_plan_it_brakes(robot: Robot) -> None:
    expired = Plan(PlanState.EXPIRED, reason="the last answer is too old")
    moving = [0.0, 0.0, 0.0, 0.8, 0.0]
    driven = drive(
        MppiController(robot, SMALL, tick_s=0.05),
        moving,
        ticks=15,
        at_tick=lambda *_: {"cost_map": EMPTY, "goal": GOAL, "anchors": expired},
    )

    assert driven.commands[0].braking
    assert driven.commands[0].reason == "the last answer is too old"
    np.testing.assert_allclose(np.diff(driven.states[:11, 3]), -1.5 * 0.05, atol=2e-2)
    assert np.abs(driven.states[-1, 3:]).max() < 1e-4
    np.testing.assert_allclose(driven.commands[0].motion[-1, 0], 0.8**2 / 3.0, atol=0.05)


def test_it_brakes_before_what_it_cannot_pass() -> None:
    """Somebody stands up right before a robot at full speed."""
    robot = Robot(kind="ackermann", v_max=1.0, a_max=1.5, radius=0.3, min_turning_radius=2.0)
    shut = square_map((slice(0, 100), slice(60, 64)))
    command = MppiController(robot, SMALL, tick_s=0.05).command(
        [0.5, 0.0, 0.0, 1.0, 0.0], cost_map=shut, goal=[3.0, 0.0]
    )
    assert command.braking
    assert command.reason is not None
    assert "collides in" in command.reason
    assert command.u[0] == pytest.approx(1.0 - 1.5 * 0.05)


def test_a_robot_in_touch_with_a_wall_drives_away(robot: Robot) -> None:
    driven = drive(
        MppiController(robot, SMALL, tick_s=0.05),
        [-0.48, 0.0, np.pi, 0.0, 0.0],
        ticks=100,
        at_tick=lambda *_: {"cost_map": WALL, "goal": [-3.0, 0.0]},
    )
    assert wall_distance(driven.places)[0] < robot.reach
    assert np.linalg.norm(driven.places[-1] - [-3.0, 0.0]) < 0.5


def test_it_keeps_to_its_way_though_the_better_one_changes() -> None:
    """At every tick the anchors of the other side are those off the route, 0.2 m dearer."""
    robot = Robot(kind="omni", v_max=1.0, a_max=1.5, radius=0.3)
    batch = round_the_wall()

    def at_tick(tick: int, _: np.ndarray) -> dict[str, Any]:
        plan = Plan(
            PlanState.FRESH,
            batch=batch,
            age_ms=50.0 * tick,
            best=tick % 2,
            on_route=np.arange(2) == tick % 2,
        )
        return {"cost_map": WALL, "goal": [3.0, 0.0], "anchors": plan}

    def turns(switch_cost: float) -> int:
        config = MppiConfig(motions=256, steps=30, off_route=0.2, switch_cost=switch_cost)
        controller = MppiController(robot, config, tick_s=0.05)
        driven = drive(controller, START, ticks=50, at_tick=at_tick)
        sides = np.sign([command.motion[-1, 1] for command in driven.commands])
        return int((np.diff(sides) != 0.0).sum())

    assert turns(switch_cost=1.0) == 0
    assert turns(switch_cost=0.0) > 3


def test_the_same_seed_is_the_same_drive() -> None:
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, radius=0.3)
    first, second, other = (cross(robot, ticks=10, seed=seed).states for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert (first != other).any()


def test_where_the_map_lies_does_not_matter() -> None:
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, radius=0.3)
    away = np.array([512_000.0, 5_400_000.0])
    moved = CostMap.build(WALL.data, 0.1, WALL.origin + away)
    here = cross(robot, ticks=1).commands[0]
    controller = MppiController(robot, SMALL, tick_s=0.05)
    state = np.array([*(START[:2] + away), *START[2:]])
    there = controller.command(state, cost_map=moved, goal=GOAL + away)

    np.testing.assert_allclose(there.u, here.u, atol=1e-4)
    np.testing.assert_allclose(there.motion[:, :2] - away, here.motion[:, :2], atol=1e-3)


def test_another_map_is_seen_at_once() -> None:
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, radius=0.3)
    controller = MppiController(robot, SMALL, tick_s=0.05)
    shut = square_map((slice(0, 100), slice(56, 60)))
    free = controller.command([0.0, 0, 0, 0.9, 0], cost_map=EMPTY, goal=[3.0, 0.0])
    closed = controller.command([0.0, 0, 0, 0.9, 0], cost_map=shut, goal=[3.0, 0.0])

    assert free.motion[-1, 0] > 1.0
    assert closed.motion[-1, 0] < 0.31


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"state": [0.0, 0.0, 0.0]}, r"state: expected shape \[5\], got \[3\]"),
        ({"state": [0.0, np.nan, 0.0, 0.0, 0.0]}, "expected finite numbers, got nan at state"),
        ({"goal": [1.0]}, r"goal: expected shape \[2\], got \[1\]"),
        ({"speed_limit": 0.0}, "speed_limit: expected a number in"),
        ({"cost_map": {"data": np.zeros((1, 32, 32))}}, "cost_map.resolution: this field"),
        ({"anchors": 3}, "anchors: expected an AnchorBatch or a Plan, got a int"),
        ({"obstacles": {"position": [[0, 0]], "radius": [0.3]}}, "obstacles.velocity: this field"),
    ],
)
def test_bad_input_is_named(given: dict[str, Any], message: str) -> None:
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, radius=0.3)
    controller = MppiController(robot, SMALL)
    told: dict[str, Any] = {"state": START, "cost_map": EMPTY, "goal": GOAL} | given
    with pytest.raises(InvalidRequest, match=message):
        controller.command(told.pop("state"), **told)
