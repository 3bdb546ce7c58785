"""Robots against motions in closed form, and along anchors at the speed of their own."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from anchorflow_benchmarks.closed_loop.anchor_sources import LinesSource
from anchorflow_benchmarks.closed_loop.drive import Drive, DriveConfig, End
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig, MppiController
from anchorflow_benchmarks.closed_loop.path_following import motions_along, timed_paths
from anchorflow_benchmarks.closed_loop.robots import (
    ROBOTS,
    DoubleIntegrator,
    Jackal,
    Robot,
    Unicycle,
)
from anchorflow_benchmarks.closed_loop.simulated_time import LatencyExecutor, SimulatedTime
from anchorflow_benchmarks.closed_loop.worlds import World
from anchorflow_client import AnchorBatch, AnchorRequest
from anchorflow_client.contract import ModelId
from anchorflow_client.planner import Plan, Planner, PlanState

MAP = {"map_cells": 96, "map_resolution": 0.1}
BOTH = [Unicycle(), DoubleIntegrator()]


def driven(robot: Robot, state: torch.Tensor, control: list[float], steps: int, dt: float):
    for _ in range(steps):
        state = robot.step(state, torch.tensor(control), dt)
    return state


def test_a_unicycle_at_constant_speed_and_yaw_rate_drives_a_circle() -> None:
    speed, yaw_rate = 1.0, 0.5
    ends = []
    for steps in (10, 20):
        state = torch.tensor([0.0, 0.0, 0.0, speed, yaw_rate], dtype=torch.float64)
        for _ in range(steps):
            state = Unicycle().step(state, torch.zeros(2, dtype=torch.float64), 2.0 / steps)
        ends.append(state[:2].numpy())
    radius, angle = speed / yaw_rate, yaw_rate * 2.0
    exact = radius * np.array([math.sin(angle), 1.0 - math.cos(angle)])

    errors = [np.linalg.norm(end - exact) for end in ends]
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)  # the midpoint's second order


def test_a_double_integrator_falls() -> None:
    end = driven(DoubleIntegrator(), torch.tensor([1.0, 2.0, 0.5, 0.0]), [0.0, 1.0], 1000, 0.001)
    np.testing.assert_allclose(end.numpy(), [1.5, 2.5, 0.5, 1.0], atol=2e-3)


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=30))
@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_no_control_breaks_the_limits(name: str, controls: list[tuple[float, float]]) -> None:
    robot = ROBOTS[name]()
    state = robot.start(np.zeros(3))
    for control in controls:
        after = robot.step(state, torch.tensor(control, dtype=torch.float32), 0.1)
        assert float(robot.speed(after).abs()) <= robot.v_max + 1e-5
        dim = len(robot.x_curr(after)) // 3
        change = (robot.x_curr(after) - robot.x_curr(state))[dim : dim + 2]
        if isinstance(robot, DoubleIntegrator):
            assert np.linalg.norm(change) <= robot.a_max * 0.1 + 1e-5
        else:
            assert abs(float(after[3] - state[3])) <= robot.a_max * 0.1 + 1e-5
        state = after


@pytest.mark.parametrize("robot", BOTH)
def test_braking_ends_at_rest_and_stays_there(robot: Robot) -> None:
    state = robot.start(np.zeros(3))
    state = driven(robot, state, [2.0, 1.0], 6, 0.1)
    for _ in range(12):
        state = robot.step(state, robot.braking(state, 0.1), 0.1)
    assert float(robot.speed(state).abs()) < 1e-6
    rest = robot.pose(state)
    np.testing.assert_array_equal(
        robot.pose(robot.step(state, robot.braking(state, 0.1), 0.1)), rest
    )


def test_a_unicycle_tells_its_velocity_and_its_bend_in_the_map_frame() -> None:
    state, aside = torch.tensor([1.0, 2.0, math.pi / 3, 1.5, 0.7]), 1.5 * 0.7
    expected = [1.0, 2.0, 0.75, 1.5 * math.sin(math.pi / 3)]
    expected += [-aside * math.sin(math.pi / 3), 0.5 * aside]
    np.testing.assert_allclose(Unicycle().x_curr(state), expected, atol=1e-6)
    # v w = 5 m/s^2 to the right is more than anchors may be asked to begin with.
    state = torch.tensor([0.0, 0.0, 0.0, 2.0, -2.5])
    np.testing.assert_allclose(Unicycle().x_curr(state), [0, 0, 2, 0, 0, -3], atol=1e-6)


def test_a_rectangle_is_as_near_to_a_post_as_its_nearest_edge_or_corner() -> None:
    posts = np.array([[2.0, 0.0], [1.0, 3.0]])
    world = World("two", posts, 0.1, np.zeros(3), np.array([5.0, 0.0]), 5.0)
    robot = Jackal()
    for pose, room in (
        ([1.0, 0.0, 0.0], 1.0 - 0.254 - 0.1),
        ([2.0, 1.0, 0.0], 1.0 - 0.215 - 0.1),
        ([2.0, 1.0, math.pi / 2], 1.0 - 0.254 - 0.1),
        ([3.0, -1.0, 0.0], math.hypot(1 - 0.254, 1 - 0.215) - 0.1),
        ([2.0, 0.1, 0.0], -0.115 - 0.1),
    ):
        assert robot.room(world, robot.start(np.array(pose))) == pytest.approx(room, abs=1e-6)
    state = torch.tensor([1.0, 2.0, math.pi / 2, 1.5, 0.7])
    expected = [1, 2, math.pi / 2, 0, 1.5, 0.7, -1.5 * 0.7, 0, 0]
    np.testing.assert_allclose(robot.x_curr(state), expected, atol=1e-6)


@pytest.mark.parametrize("robot", BOTH)
def test_a_path_is_followed_to_its_end(robot: Robot) -> None:
    bend = torch.linspace(0.0, math.pi / 2, 64)
    paths = torch.stack([2.0 * torch.sin(bend), 2.0 - 2.0 * torch.cos(bend)], 1)[None]
    _, states = motions_along(robot, paths, robot.start(np.zeros(3)), steps=60, dt=0.1, speed=1.0)

    places = states[0, :, :2]
    off = ((places[:, None] - paths[0]) ** 2).sum(-1).min(1).values.sqrt()
    assert float(off.max()) < 0.1
    assert float((places[-1] - paths[0, -1]).norm()) < 0.15
    assert float(robot.speed(states).max()) <= 1.0 + 1e-5


def test_a_unicycle_turns_on_the_spot_to_a_path_behind_it() -> None:
    line = torch.stack([-torch.linspace(0.0, 2.0, 64), torch.zeros(64)], 1)[None]
    start = Unicycle().start(np.zeros(3))
    _, states = motions_along(Unicycle(), line, start, steps=60, dt=0.1, speed=1.0)

    assert float(states[0, :, 1].abs().max()) < 0.25
    assert float(states[0, -1, 0]) < -1.5


@pytest.mark.parametrize("robot", BOTH)
def test_the_states_are_those_that_the_controls_bring_about(robot: Robot) -> None:
    paths = torch.randn(3, 64, 2, generator=torch.Generator().manual_seed(1)).cumsum(1) * 0.05
    state = robot.start(np.array([0.1, 0.0, 0.3]))
    controls, states = motions_along(robot, paths, state, steps=20, dt=0.1, speed=1.5)
    current = state.expand(3, -1)
    for step in range(20):
        current = robot.step(current, controls[:, step], 0.1)
        torch.testing.assert_close(current, states[:, step])


def straight_request(**fields: Any) -> AnchorRequest:
    """A request from (-2, 0) to (2, 0), from rest to rest, on a free map."""
    return AnchorRequest.build(
        cost_map={"data": np.zeros((1, 16, 16)), "resolution": 0.5},
        x_curr=[-2, 0, 0, 0, 0, 0],
        x_goal=[2, 0, 0, 0],
        **fields,
    )


def at_speeds(speeds: list[float], *, length: float = 3.0, steps: int = 16) -> AnchorBatch:
    """Straight anchors of one length, each at its own constant speed."""
    way = np.linspace(0.0, length, steps)
    paths = np.stack([np.stack([way, 0.0 * way], 1)] * len(speeds))
    velocities = np.zeros_like(paths)
    velocities[..., 0] = np.array(speeds)[:, None]
    return AnchorBatch(
        arrays={
            "trajectories": paths,
            "velocities": velocities,
            "accelerations": np.zeros_like(paths),
        },
        dt=length / np.array(speeds) / (steps - 1),
        seed=0,
        model=ModelId("m", "1", ""),
        timing_ms={},
    )


def test_a_plan_at_the_controllers_period() -> None:
    plan = Plan(PlanState.FRESH, at_speeds([0.5, 2.0]), age_ms=200.0)
    paths, speeds = timed_paths(plan, period_s=0.1)

    assert paths.shape == (2, 61, 2)  # 6 s at 0.5 m/s
    torch.testing.assert_close(paths[0, :5, 0], 0.1 + 0.05 * torch.arange(5.0))
    torch.testing.assert_close(paths[1, :5, 0], 0.4 + 0.2 * torch.arange(5.0))
    assert (paths[1, 20:] == paths[1, 20]).all()  # it has arrived, and stays
    torch.testing.assert_close(speeds, torch.tensor([[0.5], [2.0]]).expand(2, 61))


@pytest.mark.parametrize("robot", BOTH)
def test_each_anchor_is_driven_at_its_own_pace(robot: Robot) -> None:
    plan = Plan(PlanState.FRESH, at_speeds([0.5, 1.2]), age_ms=0.0)
    paths, paces = timed_paths(plan, period_s=0.1)
    state = robot.start(np.zeros(3))
    _, own = motions_along(robot, paths, state, steps=20, dt=0.1, speed=1.5, paces=paces)
    _, cruise = motions_along(robot, paths, state, steps=20, dt=0.1, speed=1.5)

    assert robot.speed(own[:, 12]).tolist() == pytest.approx([0.5, 1.2], abs=0.02)
    assert robot.speed(cruise[:, 12]).tolist() == pytest.approx([1.5, 1.5], abs=0.02)


@pytest.mark.parametrize("limits", [{}, {"v_max": 0.5, "a_max": 2.5}, {"v_max": 9.0, "a_max": 1.0}])
def test_lines_last_as_long_as_the_limits_allow(limits: dict[str, float]) -> None:
    batch = LinesSource().plan_request(straight_request(num_samples=4, seed=1, **limits))
    v_max, a_max = limits.get("v_max", 2.0), limits.get("a_max", 3.0)
    straight = batch.velocities[0], batch.accelerations[0]
    shares = [
        np.linalg.norm(rate, axis=-1).max() / limit
        for rate, limit in zip(straight, (v_max, a_max), strict=True)
    ]
    assert max(shares) == pytest.approx(1.0, abs=0.02)  # one of the limits binds
    assert (batch.durations[1:] > batch.durations[0]).all()  # bent lines are longer
    fixed = LinesSource(8.0).plan_request(straight_request())
    assert fixed.durations == pytest.approx(8.0)


class Recorded:
    """Lines, with a record of the requests."""

    def __init__(self, horizon_s: float | None) -> None:
        self.lines, self.requests = LinesSource(horizon_s), list[AnchorRequest]()

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        self.requests.append(request)
        return self.lines.plan_request(request)


@pytest.mark.parametrize("horizon_s", [None, 8.0])
def test_only_a_fixed_duration_makes_a_robot_ask_in_slow_motion(
    horizon_s: float | None, world: Callable[..., World]
) -> None:
    clock, source = SimulatedTime(), Recorded(horizon_s)
    config = DriveConfig(horizon_s=horizon_s, options={"num_samples": 8}, **MAP)
    planner = Planner(
        source, config.asking(0.03), clock=clock, executor=LatencyExecutor(clock, fixed_s=0.05)
    )
    robot = Unicycle()
    controller = MppiController(robot, MppiConfig(samples=64, steps=20), tick_s=0.1)
    drive = Drive(world(), controller, planner=planner, clock=clock, config=config)
    speeds: list[float] = []
    run = drive.run(lambda _: speeds.append(float(robot.speed(drive.state))))

    asked = [float(np.linalg.norm(request.x_curr[0, 2:4])) for request in source.requests]
    assert run.end is End.GOAL
    assert max(speeds) > 1.2
    assert (max(asked) > 1.2) == (horizon_s is None)
    assert {(r.v_max, r.a_max, r.robot_radius) for r in source.requests} == {(2.0, 3.0, 0.25)}
    through = [np.linalg.norm(r.x_goal[0, 2:]) for r in source.requests]
    assert max(through) == pytest.approx(1.5 if horizon_s is None else 0.6)
