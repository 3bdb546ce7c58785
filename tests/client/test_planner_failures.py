"""The planner while answers fail, hang or arrive too late."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from staged_planner import Stage, batch_for

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    ConnectionFailed,
    InvalidAnswer,
    InvalidRequest,
    Overloaded,
    TimedOut,
)
from anchorflow_client.planner import PlannerConfig
from anchorflow_client.planner.plan import PlanState


class Tensor:
    """A tensor of another library, with gradients."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        raise RuntimeError("use detach()")


HOLDS_ITSELF: list[Any] = []
HOLDS_ITSELF.append(HOLDS_ITSELF)


def test_a_failure_keeps_the_last_plan_until_an_answer(stage: Stage) -> None:
    good = stage.cycle()
    lost = ConnectionFailed("nobody listens")
    stage.update()
    stage.fail(lost)
    plan = stage.planner.wait(0.0)
    assert plan.state is PlanState.HELD
    assert plan.batch is good.batch
    assert plan.last_error is lost

    stage.update()
    stage.now += 0.1
    plan = stage.cycle()
    assert plan.state is PlanState.FRESH
    assert plan.last_error is None


def test_pauses_grow_while_the_server_is_lost() -> None:
    stage = Stage(PlannerConfig(period_ms=10.0, first_retry_ms=100.0, longest_retry_ms=400.0))
    asked_at = []
    for _ in range(2000):
        stage.update()
        if stage.waiting:
            asked_at.append(stage.now)
            stage.fail(ConnectionFailed("nobody listens"))
        stage.now += 0.001

    # A failure is noticed at the tick after it: each wait is one tick longer.
    np.testing.assert_allclose(
        np.diff(asked_at), [0.101, 0.201, 0.401, 0.401, 0.401, 0.401], atol=1e-6
    )


def test_an_overloaded_service_is_left_alone_for_as_long_as_it_says(stage: Stage) -> None:
    stage.update()
    stage.fail(Overloaded("too many", retry_after_s=3.0))
    stage.update()
    stage.now += 2.9
    stage.update()
    assert stage.waiting == []
    stage.now += 0.1
    stage.update()
    assert len(stage.waiting) == 1


@pytest.mark.parametrize(
    ("view", "field"),
    [
        ({"x_curr": [np.nan, 0, 0, 0, 0, 0]}, "x_curr"),
        ({"x_curr": np.zeros((2, 6))}, "x_curr"),
        ({"x_curr": [0.0]}, "x_curr"),
        ({"x_curr": []}, "x_curr"),
        ({"x_curr": "abc"}, "x_curr"),
        ({"x_curr": None}, "x_curr"),
        ({"x_goal": [np.nan, 0, 0, 0]}, "x_goal"),
        ({"x_goal": [np.inf, 0, 0, 0]}, "x_goal"),
        ({"x_goal": [1.0]}, "x_goal"),
        ({"x_goal": np.zeros((2, 4))}, "x_goal"),
        ({"cost_map": np.zeros((2, 1, 16, 16))}, "cost_map.data"),
        ({"cost_map": [[0.0, 0.0], [0.0]]}, "cost_map.data"),
        ({"cost_map": np.full((16, 16), np.nan)}, "cost_map.data"),
        ({"cost_map": None}, "cost_map"),
        ({"cost_map": np.ones((16, 16))}, "cost_map.data"),  # no room for a goal
        ({"seed": "a"}, "seed"),
        ({"cost_map": Tensor()}, "cost_map.data"),
        ({"cost_map": {"data": Tensor(), "resolution": 0.5}, "resolution": None}, "cost_map.data"),
        ({"x_curr": Tensor()}, "x_curr"),
        ({"origin": Tensor()}, "cost_map.origin"),
        ({"w_style": Tensor()}, "w_style"),
        ({"warm_start": {"trajectory": Tensor()}}, "warm_start.trajectory"),
        ({"v_max": "fast"}, "v_max"),
        ({"obstacles": {"position": [[1, 0]], "radius": [0.3]}}, "obstacles.velocity"),
        ({"obstacles": {"position": HOLDS_ITSELF}}, "obstacles.radius"),
        ({"obstacles": {}, "obstacles_age_s": -0.1}, "obstacles_age_s"),
        ({"model": ["lines"]}, "model"),
        ({"w_style": HOLDS_ITSELF}, "w_style"),
    ],
)
def test_no_error_of_an_observation_is_raised(
    stage: Stage, view: dict[str, Any], field: str
) -> None:
    stage.cycle()
    stage.update(**view)
    while stage.waiting:
        stage.answer()
    plan = stage.planner.wait(0.0)

    assert isinstance(plan.last_error, InvalidRequest)
    assert plan.last_error.field == field
    assert plan.state is PlanState.HELD
    stage.now += 0.1
    assert stage.cycle().last_error is None


def test_a_state_that_is_none_does_not_set_a_stuck_robot_free() -> None:
    stage = Stage(PlannerConfig(stuck_s=0.45, stuck_m=0.3))
    for _ in range(4):
        stage.cycle()
    stage.update(x_curr=[np.nan] * 6)
    stage.now += 0.1

    assert stage.update().stuck


def test_a_hanging_request_is_given_up_and_its_late_answer_dropped(stage: Stage) -> None:
    stage.update()
    stage.now += 1.1
    plan = stage.update()
    assert isinstance(plan.last_error, TimedOut)
    stage.now += 0.1
    stage.update()
    stage.answer(which=1)  # the second request overtakes the first
    assert stage.planner.wait(0.0).request_id == stage.requests[0].request_id
    stage.answer()
    plan = stage.planner.wait(0.0)

    assert plan.request_id == stage.requests[0].request_id
    assert plan.request_id != stage.requests[1].request_id
    assert dict(stage.planner.counts) == {"asked": 2, "answered": 1, "failed": 1, "dropped": 1}


def test_no_more_than_two_requests_hang(stage: Stage) -> None:
    for _ in range(100):
        stage.update()
        stage.now += 0.5
    assert len(stage.waiting) == 2
    stage.answer()
    stage.update()
    stage.now += 3.0
    stage.update()
    assert len(stage.waiting) == 2


@pytest.mark.parametrize("odd", ["mixed up", "batched", "bare"])
def test_an_answer_that_no_loop_can_follow_is_refused(stage: Stage, odd: str) -> None:
    def answer(request: AnchorRequest) -> AnchorBatch:
        good = batch_for(request)
        if odd == "mixed up":
            return replace(good, request_id="another's")
        if odd == "bare":
            return replace(good, arrays={"trajectories": good.trajectories})
        return replace(good, arrays={name: array[None] for name, array in good.arrays.items()})

    stage.cycle()
    stage.reply = answer
    plan = stage.cycle()

    assert plan.state is PlanState.HELD
    assert isinstance(plan.last_error, InvalidAnswer)
    wanted = "expected trajectories, velocities, accelerations [N,T,D], got trajectories"
    if odd == "mixed up":
        wanted = f"request_id: expected the answer to {stage.requests[-1].request_id}, got that to"
    assert str(plan.last_error).startswith(wanted)


@given(st.lists(st.sampled_from(["tick", "long tick", "answer", "newest", "fail"]), max_size=60))
def test_whatever_happens_no_plan_is_too_old_and_none_goes_back(events: list[str]) -> None:
    stage = Stage(PlannerConfig(max_age_ms=500.0, period_ms=50.0))
    newest = -1
    for event in events:
        if event == "answer" and stage.waiting:
            stage.answer()
        elif event == "newest" and stage.waiting:
            stage.answer(which=-1)
        elif event == "fail" and stage.waiting:
            stage.fail(ConnectionFailed("nobody listens"))
        stage.now += 0.4 if event == "long tick" else 0.06
        plan = stage.update()

        assert plan.usable == (plan.state in (PlanState.FRESH, PlanState.HELD))
        assert plan.usable == (plan.age_ms <= 500.0)
        if plan.request_id is not None:
            number = int(plan.request_id.rpartition("-")[2])
            assert number >= newest
            newest = number
        assert len(stage.waiting) <= 2
