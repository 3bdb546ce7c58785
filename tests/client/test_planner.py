"""The planner in a control loop: it sends requests, ages its plans and returns the newest."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from staged_planner import VIEW, Stage, batch_for, nothing_safe

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    ConnectionFailed,
    CostMap,
    InvalidRequest,
    Obstacles,
    Overloaded,
    WarmStart,
)
from anchorflow_client.planner import Planner, PlannerConfig
from anchorflow_client.planner.plan import PlanState


def test_before_the_first_answer_the_loop_waits(stage: Stage) -> None:
    plan = stage.update()

    assert plan.state is PlanState.WAITING
    assert not plan.usable
    assert not plan.expired
    assert stage.requests == []  # nothing was asked on the loop's own thread


def test_an_answer_is_returned_by_the_next_update(stage: Stage) -> None:
    stage.update()
    stage.now += 0.3
    stage.answer()
    stage.now += 0.2
    plan = stage.update()

    assert plan.state is PlanState.FRESH
    assert plan.batch is not None
    assert plan.request_id == stage.requests[0].request_id == plan.batch.request_id
    assert plan.age_ms == pytest.approx(500.0)  # since the observation, not since the answer
    assert stage.requests[0].budget_ms == 1000.0  # no longer than its plan is usable


def test_the_states_of_a_plan_start_at_the_robots_present_position(stage: Stage) -> None:
    with pytest.raises(ValueError, match="usable plan, got one that is waiting"):
        stage.update().states()
    stage.answer()
    stage.now += 0.75
    plan = stage.planner.wait(0.0)

    expected = np.array([[0.75, 0, 1, 0, 0, 0], [1.5, 0, 2, 0, 0, 0]])
    np.testing.assert_allclose(plan.states()[:, 0], expected)
    ahead = plan.states(ahead_s=0.05)[1, 0]
    np.testing.assert_allclose(ahead, [1.6, 0.0, 2.0, 0.0, 0.0, 0.0], atol=1e-6)


def test_one_request_at_a_time_and_no_two_within_the_period(stage: Stage) -> None:
    stage.update()
    stage.update()
    assert len(stage.waiting) == 1
    stage.answer()
    stage.now += 0.05
    stage.update()
    assert stage.waiting == []
    stage.now += 0.05
    stage.update()
    assert len(stage.waiting) == 1


def test_a_request_holds_copies_of_the_loops_arrays(stage: Stage) -> None:
    grid, state = np.zeros((16, 16)), np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    origin, style, path = np.array([-4.0, -4.0]), np.array([1.0, 0.0, 0.0]), np.zeros((4, 2))
    schedule = [0.0, 0.5, 1.0]
    stage.update(
        cost_map=grid,
        x_curr=state,
        origin=origin,
        w_style=style,
        warm_start=WarmStart(path, 0.5),
        sampler={"method": "euler", "schedule": schedule},
    )
    grid[:], state[:] = 1.0, 9.0
    origin[:], style[:], path[:] = -3.0, [0.0, 0.0, 1.0], 9.0
    schedule.insert(1, 0.25)
    stage.answer()

    (sent,) = stage.requests
    assert sent.cost_map.data.max() == 0.0
    assert sent.x_curr[0, 0] == 0.0
    np.testing.assert_array_equal(sent.cost_map.origin, [-4.0, -4.0])
    np.testing.assert_array_equal(sent.w_style, [[1.0, 0.0, 0.0]])
    assert sent.warm_start is not None
    assert sent.warm_start.trajectory.max() == 0.0
    assert sent.sampler is not None
    assert sent.sampler.schedule == (0.0, 0.5, 1.0)


def test_obstacles_are_copied_and_moved_to_the_moment_of_the_state(stage: Stage) -> None:
    position, velocity = np.array([[1.0, 0.0], [2.0, 1.0]]), np.array([[0.0, -1.0], [0.5, 0.0]])
    seen = {"position": position, "velocity": velocity, "radius": [0.3, 0.2], "growth": 0.1}
    as_objects = Obstacles(position, velocity, np.array([0.3, 0.2]), growth=0.1)
    for told in (seen, as_objects):
        for age in ({}, {"obstacles_age_s": 0.2}):
            stage.update(obstacles=told, **age)
            position += 7.0
            stage.answer()
            position -= 7.0
            stage.now += 0.1

            later, sent = age.get("obstacles_age_s", 0.0), stage.requests[-1].obstacles
            assert sent is not None
            np.testing.assert_allclose(sent.position, position + later * velocity)
            np.testing.assert_allclose(sent.radius, np.array([0.3, 0.2]) + 0.1 * later)
    stage.cycle(obstacles={"position": [], "velocity": [], "radius": []}, obstacles_age_s=0.2)
    sent = stage.requests[-1].obstacles
    assert sent is not None
    assert not len(sent.position)


@pytest.mark.parametrize(("age_s", "on_route"), [(0.0, [False, True]), (0.5, [True, True])])
def test_anchors_before_and_behind_a_person_are_on_two_routes(
    stage: Stage, age_s: float, on_route: list[bool]
) -> None:
    """The second anchor passes before a person of whom it was told at once, else behind as well."""
    walker = {"position": [[1.0, -0.75]], "velocity": [[0.0, 1.0]], "radius": [0.2]}

    plan = stage.cycle(obstacles=walker, obstacles_age_s=age_s)

    assert plan.on_route is not None
    assert plan.on_route.tolist() == on_route


def test_a_cost_map_object_is_copied_too(stage: Stage) -> None:
    grid = np.zeros((1, 16, 16), np.float32)
    stage.update(cost_map=CostMap(grid, 0.5, np.array([-4.0, -4.0])), resolution=None)
    grid[:] = 1.0
    stage.answer()

    assert stage.requests[0].cost_map.data.max() == 0.0


def test_further_fields_go_into_the_request(stage: Stage) -> None:
    stage.cycle(num_samples=8, budget_ms=40.0, sampler={"method": "euler"})

    sent = stage.requests[0]
    assert (sent.num_samples, sent.budget_ms) == (8, 40.0)
    assert sent.sampler is not None
    assert sent.sampler.method == "euler"


def test_an_old_plan_is_expired_and_has_no_batch(stage: Stage) -> None:
    stage.cycle()
    stage.now += 0.9
    assert stage.planner.wait(0.0).state is PlanState.FRESH
    stage.now += 0.001
    plan = stage.planner.wait(0.0)

    assert plan.expired
    assert plan.batch is None
    assert plan.age_ms > 1000.0


def test_the_margin_is_sent_and_certified() -> None:
    stage = Stage(PlannerConfig(margin_m=0.07))
    stage.cycle()
    stage.cycle(refine={"project": False, "certified_margin": 0.2})

    first, second = (request.refine for request in stage.requests)
    assert first is not None
    assert first.certified_margin == 0.07
    assert second is not None
    assert (second.project, second.certified_margin) == (False, 0.2)


def test_a_plan_names_its_best_anchor_those_of_its_route_and_why_none_is_safe(
    stage: Stage,
) -> None:
    def unsafe(request: AnchorRequest) -> AnchorBatch:
        return replace(nothing_safe(request), reason="none of 2 anchors is safe: a wall")

    plan = stage.cycle()

    assert plan.best == 1
    assert plan.on_route is not None
    assert plan.on_route.tolist() == [True, True]
    assert plan.reason is None
    assert plan.followable
    stage.reply = unsafe
    plan = stage.cycle()

    assert plan.reason == "none of 2 anchors is safe: a wall"
    assert plan.usable
    assert not plan.followable


def test_a_robot_that_gets_nowhere_asks_with_another_seed_and_from_noise() -> None:
    stage = Stage(PlannerConfig(stuck_s=0.45, stuck_m=0.3, cold_every=100))
    plans = [stage.cycle(seed=7) for _ in range(5)]
    assert not any(plan.stuck for plan in plans)
    assert stage.update(seed=7).stuck
    stage.answer()

    assert stage.planner.counts["stuck"] == 1
    seeds = [request.seed for request in stage.requests]
    assert seeds == [7] * 5 + [8]
    assert stage.requests[-2].warm_start is not None
    assert stage.requests[-1].warm_start is None


def test_after_a_reset_nothing_old_comes_back_and_a_request_is_due(stage: Stage) -> None:
    stage.cycle()
    stage.update()
    stage.planner.reset()
    stage.answer()
    plan = stage.planner.wait(0.0)

    assert plan.state is PlanState.WAITING
    assert stage.planner.counts["dropped"] == 1
    stage.now += 0.1
    assert stage.cycle().request_id == stage.requests[-1].request_id
    assert stage.requests[-1].warm_start is None

    stage.update()
    stage.fail(Overloaded("full", retry_after_s=60.0))
    stage.update()
    stage.planner.reset()
    stage.update()

    assert len(stage.waiting) == 1


@pytest.mark.parametrize("asked", [False, True])
def test_a_clock_that_goes_back_resets_the_planner(stage: Stage, asked: bool) -> None:
    stage.cycle()
    if asked:
        stage.update()
    stage.now = 3.0
    plan = stage.planner.wait(0.0)
    assert plan.state is PlanState.WAITING
    assert plan.batch is None
    stage.update()
    while stage.waiting:
        stage.answer()
    stage.now += 0.2
    plan = stage.update()

    assert plan.state is PlanState.FRESH
    assert plan.age_ms == pytest.approx(200.0)
    assert plan.states()[0, 0, 0] == pytest.approx(0.2)


def test_settings_of_numpy_do_not_round_the_time() -> None:
    period_ms: Any = np.float32(100)
    stage = Stage(PlannerConfig(period_ms=period_ms))
    stage.now = 1.8e9  # where float32 counts by 128 s
    stage.cycle(seconds=0.05)
    stage.update()

    assert stage.waiting == []


def test_which_anchor_is_followed_has_to_be_one(stage: Stage) -> None:
    stage.planner.follow(999)  # of no answer yet
    stage.cycle()
    index: Any
    for index in (-1, 2, 0.5, None):
        with pytest.raises(InvalidRequest, match="index: expected an integer from 0 to 1, got"):
            stage.planner.follow(index)
    index = np.int64(0)
    stage.planner.follow(index)
    stage.cycle()
    assert stage.requests[1].warm_start is not None


def test_a_planner_that_is_closed_asks_no_more_and_says_so(stage: Stage) -> None:
    stage.cycle()
    stage.planner.close()
    plan = stage.update()

    assert stage.waiting == []
    assert plan.state is PlanState.HELD
    assert isinstance(plan.last_error, ConnectionFailed)
    assert str(plan.last_error) == "the planner is closed, and asks no more"


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("max_age_ms", 0.0),
        ("period_ms", float("nan")),
        ("first_retry_ms", -1.0),
        ("warm_tau", 1.0),
        ("cold_every", 0),
        ("cold_every", 1.5),
        ("cold_every", float("nan")),
        ("max_age_ms", float("inf")),
        ("max_age_ms", "1000"),
        ("period_ms", float("inf")),
        ("goal_clearance_m", float("inf")),
        ("margin_m", 6.0),
        ("through_speed", -1.0),
    ],
)
def test_a_setting_out_of_range_is_named(setting: str, value: object) -> None:
    settings: dict[str, Any] = {setting: value}
    with pytest.raises(ValueError, match=f"^{setting}: expected"):
        PlannerConfig(**settings)


def test_the_loop_continues_while_the_client_hangs() -> None:
    gate, entered, threads = threading.Event(), threading.Event(), list[threading.Thread]()

    class Gated:
        def plan_request(self, request: AnchorRequest) -> AnchorBatch:
            threads.append(threading.current_thread())
            entered.set()
            assert gate.wait(30)
            return batch_for(request)

    with Planner(Gated(), PlannerConfig(max_age_ms=1e6)) as planner:
        assert planner.wait(0.0).state is PlanState.WAITING  # no request is pending
        planner.update(**VIEW)
        assert entered.wait(30)
        # An update that waited for the client would block here: the gate is closed.
        assert {planner.update(**VIEW).state for _ in range(100)} == {PlanState.WAITING}
        assert planner.wait(0.0).state is PlanState.WAITING
        gate.set()
        assert planner.wait(30).state is PlanState.FRESH
        assert planner.counts["asked"] == 1
    assert threads != [threading.current_thread()]
    assert isinstance(planner.update(**VIEW).last_error, ConnectionFailed)  # it is closed
