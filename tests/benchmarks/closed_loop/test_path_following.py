"""Anchors with durations of their own, at the controller's period and their own speed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from anchorflow_benchmarks.closed_loop.anchor_sources import LinesSource
from anchorflow_benchmarks.closed_loop.drive import Drive, DriveConfig, End
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig, MppiController
from anchorflow_benchmarks.closed_loop.path_following import motions_along, timed_paths
from anchorflow_benchmarks.closed_loop.robots import DoubleIntegrator, Robot, Unicycle
from anchorflow_benchmarks.closed_loop.simulated_time import LatencyExecutor, SimulatedTime
from anchorflow_benchmarks.closed_loop.worlds import World
from anchorflow_client import AnchorBatch, AnchorRequest
from anchorflow_client.contract import ModelId
from anchorflow_client.planner import Plan, Planner, PlanState

MAP = {"map_cells": 96, "map_resolution": 0.1}
BOTH = [Unicycle(), DoubleIntegrator()]


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


@pytest.mark.parametrize("robot", BOTH)
def test_an_anchor_from_rest_to_rest_is_driven_to_its_end(robot: Robot) -> None:
    request = straight_request(num_samples=1, v_max=1.0)
    batch = LinesSource().plan_request(request)
    paths, paces = timed_paths(Plan(PlanState.FRESH, batch, age_ms=0.0), period_s=0.1)
    start = robot.start(np.array([-2.0, 0.0, 0.0]))
    _, states = motions_along(robot, paths, start, steps=120, dt=0.1, speed=1.5, paces=paces)

    assert float(robot.speed(states).max()) == pytest.approx(1.0, abs=0.1)
    assert float(states[0, -1, 0]) == pytest.approx(2.0, abs=0.3)
    assert float(robot.speed(states[0, -1])) < 0.1


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
