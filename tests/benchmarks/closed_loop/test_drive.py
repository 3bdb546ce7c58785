"""The loop from start to end: its knowledge, its end, and a lost service."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from anchorflow_benchmarks.closed_loop.anchor_sources import LinesSource
from anchorflow_benchmarks.closed_loop.controllers import AnchorController, Controller
from anchorflow_benchmarks.closed_loop.drive import Drive, DriveConfig, End, Tick
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig, MppiController
from anchorflow_benchmarks.closed_loop.robots import DoubleIntegrator, Robot, Unicycle
from anchorflow_benchmarks.closed_loop.simulated_time import LatencyExecutor, SimulatedTime
from anchorflow_benchmarks.closed_loop.worlds import World
from anchorflow_client import AnchorBatch, AnchorRequest, ConnectionFailed
from anchorflow_client.planner import AnchorSource, Planner, PlannerConfig
from anchorflow_client.planner.plan import PlanState
from anchorflow_control import MppiConfig as ControlConfig

SMALL = MppiConfig(samples=64, steps=20)
MAP = {"map_cells": 96, "map_resolution": 0.1}


def controller(robot: Robot | None = None) -> MppiController:
    return MppiController(robot or Unicycle(), SMALL, tick_s=0.1)


def anchor_controller(robot: Robot | None = None) -> AnchorController:
    config = ControlConfig(motions=64, steps=20)
    return AnchorController(robot or Unicycle(), config, tick_s=0.1)


MAKERS = [controller, anchor_controller]


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("robot", [Unicycle(), DoubleIntegrator()])
def test_an_empty_world_is_crossed(
    robot: Robot, make: Callable[[Robot], Controller], world: Callable[..., World]
) -> None:
    run = Drive(world(), make(robot), config=DriveConfig(**MAP)).run()

    assert run.end is End.GOAL
    assert 2.5 < run.time_s < 8.0  # 5 m to where the goal counts as reached, at 2 m/s at most
    assert 5.0 <= run.length < 6.0
    assert run.clearance == np.inf


def test_the_same_seed_is_the_same_run(world: Callable[..., World]) -> None:
    posts = world([(3.0, 0.2)])
    config = DriveConfig(**MAP)
    runs = [Drive(posts, controller(), config=config, seed=s).run() for s in (3, 3, 4)]

    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


@pytest.mark.parametrize("make", MAKERS)
def test_a_robot_that_is_shut_in_runs_out_of_time(
    make: Callable[[], Controller], world: Callable[..., World]
) -> None:
    angles = np.linspace(0.0, 2 * np.pi, 60)
    ring = 1.2 * np.stack([np.cos(angles), np.sin(angles)], 1)
    run = Drive(world(ring), make(), config=DriveConfig(limit_s=3.0, **MAP)).run()

    assert run.end is End.TIMEOUT
    assert run.time_s == 3.0
    assert run.clearance >= 0.0


class Heedless(MppiController):
    """Full speed ahead."""

    def command(self, *_: object, **__: object) -> tuple[torch.Tensor, int | None]:
        return torch.tensor([3.0, 0.0]), None


def test_a_collision_ends_the_run_where_the_discs_touch(world: Callable[..., World]) -> None:
    heedless = Heedless(Unicycle(), SMALL, tick_s=0.1)
    run = Drive(world([(3.0, 0.0)]), heedless, config=DriveConfig(**MAP)).run()

    assert run.end is End.COLLISION
    assert -0.05 < run.clearance < 0.0
    assert run.length == pytest.approx(3.0 - 0.35, abs=0.05)


class Outage:
    """Straight lines, with connection errors between two moments."""

    def __init__(self, clock: SimulatedTime, begin: float, end: float) -> None:
        self.clock, self.begin, self.end = clock, begin, end
        self.lines: AnchorSource = LinesSource()

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        if self.begin <= self.clock.now < self.end:
            raise ConnectionFailed("nobody listens")
        return self.lines.plan_request(request)


@pytest.mark.parametrize(
    ("robot", "max_age_ms", "make"),
    [
        (Unicycle(), 600.0, anchor_controller),
        (DoubleIntegrator(), 600.0, controller),
        (Unicycle(), 3000.0, controller),
        (DoubleIntegrator(), 3000.0, anchor_controller),
    ],
)
def test_a_service_that_stops_for_two_seconds_is_survived(
    robot: Robot,
    max_age_ms: float,
    make: Callable[[Robot], Controller],
    world: Callable[..., World],
) -> None:
    clock, ticks, speeds = SimulatedTime(), [], []
    outage = Outage(clock, 1.0, 3.0)
    executor = LatencyExecutor(clock, fixed_s=0.05)
    planner = Planner(outage, PlannerConfig(max_age_ms=max_age_ms), clock=clock, executor=executor)
    drive = Drive(
        world(),
        make(robot),
        planner=planner,
        clock=clock,
        config=DriveConfig(options={"num_samples": 8}, **MAP),
    )

    def on_tick(tick: Tick) -> None:
        ticks.append(tick)
        speeds.append(abs(float(robot.speed(drive.state))))

    run = drive.run(on_tick)

    plans = [tick.plan for tick in ticks if tick.plan is not None]
    assert len(plans) == len(ticks)
    # No tick had a plan older than the limit to drive by.
    assert all(plan.usable == (plan.age_ms <= max_age_ms) for plan in plans)
    assert max(plan.age_ms for plan in plans if plan.usable) <= max_age_ms
    held = [plan.state for plan in plans if isinstance(plan.last_error, ConnectionFailed)]
    assert PlanState.HELD in held
    expired = [i for i, plan in enumerate(plans) if plan.expired]
    assert run.ticks_braked == sum(not plan.usable for plan in plans)
    if max_age_ms < 2000.0:
        assert expired
        # After the plan has expired it brakes hard until it stands.
        for i in expired[:-1]:
            assert speeds[i + 1] <= max(1e-6, speeds[i] - 0.2)
        assert speeds[expired[-1]] == pytest.approx(0.0, abs=1e-6)
        assert ticks[expired[-1]].time_s < 3.0 + 0.8  # a retry after the longest wait
    else:
        assert not expired  # the last good plan outlives the outage
    assert run.end is End.GOAL


def test_what_is_due_happens_in_its_order() -> None:
    clock, seen = SimulatedTime(), []
    for moment in (0.3, 0.1, 0.2, 0.1):
        clock.at(moment, lambda moment=moment: seen.append((moment, clock.now)))
    clock.advance(0.05)
    assert seen == []
    clock.advance(0.2)
    assert [moment for moment, _ in seen] == [0.1, 0.1, 0.2]
    clock.advance(1.0)
    assert [moment for moment, _ in seen] == [0.1, 0.1, 0.2, 0.3]


def lost(*_: int) -> int:
    raise ConnectionFailed("nobody listens")


@pytest.mark.parametrize("fixed_s", [0.4, None])
@pytest.mark.parametrize("work", [int.__add__, lost])
def test_an_answer_takes_its_fixed_or_measured_latency(
    work: Callable[[int, int], int], fixed_s: float | None
) -> None:
    clock, watch = SimulatedTime(), iter([7.0, 7.4])
    executor = LatencyExecutor(clock, stopwatch=lambda: next(watch), fixed_s=fixed_s)
    future = executor.submit(work, 1, 2)
    assert executor.latencies_s == pytest.approx([0.4])
    clock.advance(0.39)
    assert not future.done()
    clock.advance(0.02)
    if work is lost:
        with pytest.raises(ConnectionFailed, match="nobody listens"):
            future.result(timeout=0)
    else:
        assert future.result(timeout=0) == 3
