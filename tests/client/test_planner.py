"""The planner over a client whose answers come, fail or hang as the test says, at its own time."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anchorflow_client import (
    AnchorBatch,
    AnchorFlowError,
    AnchorRequest,
    ConnectionFailed,
    InvalidAnswer,
    InvalidRequest,
    ModelId,
    Overloaded,
    TimedOut,
)
from anchorflow_client.planner import Planner, PlannerConfig
from anchorflow_client.planner.plan import Plan, PlanState
from anchorflow_client.planner.shift import shifted, states_of

VIEW: dict[str, Any] = {
    "cost_map": np.zeros((16, 16)),
    "resolution": 0.5,
    "x_curr": [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
    "x_goal": [2.0, 0.0, 0.0, 0.0],
}
DT = 0.5


def batch_for(request: AnchorRequest) -> AnchorBatch:
    """Two anchors of five steps along x, at 1 and at 2 m/s; the second is the best."""
    times, speeds = DT * np.arange(5), np.array([1.0, 2.0], np.float32)
    paths = np.zeros((2, 5, 2), np.float32)
    paths[..., 0] = speeds[:, None] * times
    velocities = np.zeros_like(paths)
    velocities[..., 0] = speeds[:, None]
    return AnchorBatch(
        arrays={
            "trajectories": paths,
            "velocities": velocities,
            "accelerations": np.zeros_like(paths),
            "scores": speeds,
            "clearance": np.ones(2, np.float32),
            "safe": np.ones(2, bool),
        },
        dt=DT,
        seed=0,
        model=ModelId("lines", "1", "ab"),
        timing_ms={},
        request_id=request.request_id,
    )


class Stage:
    """A planner, its clock, and the requests that wait until the test lets them be answered."""

    def __init__(self, config: PlannerConfig) -> None:
        self.now = 100.0
        self.requests: list[AnchorRequest] = []
        self.waiting: list[Callable[[], None]] = []
        self.reply: Callable[[AnchorRequest], AnchorBatch] = batch_for
        self.planner = Planner(self, config, clock=lambda: self.now, executor=ByHand(self.waiting))

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        self.requests.append(request)
        return self.reply(request)

    def update(self, **view: Any) -> Plan:
        return self.planner.update(**VIEW | view)

    def answer(self, which: int = 0) -> None:
        """Let a request through: the oldest that waits unless told."""
        self.waiting.pop(which)()

    def fail(self, error: AnchorFlowError) -> None:
        """Let the oldest request that waits fail."""
        self.reply = raising(error)
        self.answer()
        self.reply = batch_for

    def cycle(self, seconds: float = 0.1, **view: Any) -> Plan:
        """Ask, be answered, and take the plan `seconds` after what was seen."""
        self.update(**view)
        self.answer()
        self.now += seconds
        return self.planner.wait(0.0)


class ByHand(Executor):
    """Runs nothing by itself."""

    def __init__(self, waiting: list[Callable[[], None]]) -> None:
        self._waiting = waiting

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()

        def run() -> None:
            try:
                future.set_result(fn(*args, **kwargs))
            except AnchorFlowError as error:
                future.set_exception(error)

        self._waiting.append(run)
        return future


def raising(error: AnchorFlowError) -> Callable[[AnchorRequest], AnchorBatch]:
    def reply(_: AnchorRequest) -> AnchorBatch:
        raise error

    return reply


@pytest.fixture
def stage() -> Stage:
    return Stage(PlannerConfig(max_age_ms=1000.0, period_ms=100.0, cold_every=3))


def test_before_the_first_answer_the_loop_waits(stage: Stage) -> None:
    plan = stage.update()

    assert plan.state is PlanState.WAITING
    assert not plan.usable
    assert not plan.expired
    assert stage.requests == []  # nothing was asked on the loop's own thread


def test_an_answer_is_handed_at_the_next_update(stage: Stage) -> None:
    stage.update()
    stage.answer()
    stage.now += 0.05
    plan = stage.update()

    assert plan.state is PlanState.FRESH
    assert plan.batch is not None
    assert plan.request_id == stage.requests[0].request_id == plan.batch.request_id


def test_age_counts_from_what_was_seen_not_from_the_answer(stage: Stage) -> None:
    stage.update()
    stage.now += 0.3
    stage.answer()
    stage.now += 0.2

    assert stage.update().age_ms == pytest.approx(500.0)


def test_the_states_of_a_plan_start_where_the_robot_should_be_now(stage: Stage) -> None:
    plan = stage.cycle(seconds=0.75)

    expected = np.array([[0.75, 0, 1, 0, 0, 0], [1.5, 0, 2, 0, 0, 0]])
    np.testing.assert_allclose(plan.states()[:, 0], expected)


def test_a_plan_without_a_batch_has_no_states(stage: Stage) -> None:
    with pytest.raises(ValueError, match="usable plan, got one that is waiting"):
        stage.update().states()


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


def test_what_the_loop_changes_afterwards_is_not_sent(stage: Stage) -> None:
    grid, state = np.zeros((16, 16)), np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    stage.update(cost_map=grid, x_curr=state)
    grid[:], state[:] = 1.0, 9.0
    stage.answer()

    assert stage.requests[0].cost_map.data.max() == 0.0
    assert stage.requests[0].x_curr[0, 0] == 0.0


def test_further_fields_go_into_the_request(stage: Stage) -> None:
    stage.cycle(num_samples=8, budget_ms=40.0, sampler={"method": "euler"})

    sent = stage.requests[0]
    assert (sent.num_samples, sent.budget_ms) == (8, 40.0)
    assert sent.sampler is not None
    assert sent.sampler.method == "euler"


def test_a_request_is_worth_no_more_time_than_its_plan(stage: Stage) -> None:
    stage.cycle()
    assert stage.requests[0].budget_ms == 1000.0


def test_an_old_plan_is_expired_and_has_no_batch(stage: Stage) -> None:
    stage.cycle()
    stage.now += 0.9
    assert stage.planner.wait(0.0).state is PlanState.FRESH
    stage.now += 0.001
    plan = stage.planner.wait(0.0)

    assert plan.expired
    assert plan.batch is None
    assert plan.age_ms > 1000.0


def test_a_failure_leaves_the_last_good_plan_and_says_why(stage: Stage) -> None:
    good = stage.cycle()
    lost = ConnectionFailed("nobody listens")
    stage.update()
    stage.fail(lost)
    plan = stage.planner.wait(0.0)

    assert plan.state is PlanState.HELD
    assert plan.batch is good.batch
    assert plan.last_error is lost


def test_an_answer_after_a_failure_clears_it(stage: Stage) -> None:
    stage.update()
    stage.fail(ConnectionFailed("nobody listens"))
    stage.update()
    stage.now += 0.1
    plan = stage.cycle()

    assert plan.state is PlanState.FRESH
    assert plan.last_error is None


def test_a_lost_server_is_asked_less_and_less_often() -> None:
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


def test_a_server_may_be_lost_for_hours() -> None:
    """2,000 doublings of a wait are more than a float holds."""
    stage = Stage(PlannerConfig(max_age_ms=10.0, period_ms=1.0, longest_retry_ms=100.0))
    for _ in range(2000):
        stage.update()
        stage.fail(ConnectionFailed("nobody listens"))
        stage.update()
        stage.now += 0.1

    assert stage.planner.counts["failed"] == 2000


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


def test_a_refused_view_is_followed_by_the_next_one(stage: Stage) -> None:
    stage.update(cost_map=np.ones((16, 16)))
    stage.answer()  # refused before it is sent: the robot stands in an obstacle
    stage.now += 0.1
    plan = stage.update()

    assert isinstance(plan.last_error, InvalidRequest)
    assert stage.requests == []
    assert len(stage.waiting) == 1


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


def test_the_answer_to_another_request_is_refused(stage: Stage) -> None:
    def mixed_up(request: AnchorRequest) -> AnchorBatch:
        answer = batch_for(request)
        object.__setattr__(answer, "request_id", "somebody else's")
        return answer

    stage.reply = mixed_up
    plan = stage.cycle()

    assert plan.state is PlanState.WAITING
    assert isinstance(plan.last_error, InvalidAnswer)
    assert "somebody else's" in str(plan.last_error)


def test_the_next_request_starts_from_the_anchor_in_use(stage: Stage) -> None:
    stage.cycle()
    stage.planner.follow(0)
    stage.now += 0.2
    stage.cycle()

    first, second = stage.requests
    assert first.warm_start is None
    assert second.warm_start is not None
    states = states_of(batch_for(first))[0]
    left = shifted(states, dt=DT, elapsed_s=0.3)
    np.testing.assert_allclose(second.warm_start.trajectory, left, atol=1e-9)
    assert (second.warm_start.tau, second.warm_start.dt) == (0.8, DT)


OWN_DT = np.array([1.0, 0.25])


def own_times(request: AnchorRequest) -> AnchorBatch:
    """The same anchors, of which the first lasts 4 s, the second 1 s."""
    return replace(batch_for(request), dt=OWN_DT)


def test_each_anchor_ages_by_its_own_clock(stage: Stage) -> None:
    stage.reply = own_times
    states = stage.cycle(0.5).states()

    assert states.shape == (2, 5, 6)
    for n, dt in enumerate(OWN_DT):
        one = states_of(own_times(stage.requests[0]))[n]
        np.testing.assert_array_equal(states[n], shifted(one, dt=dt, elapsed_s=0.5))
    # samples of the second lie 0.5 m apart in space, 0.25 s in time: halfway it is at its third
    np.testing.assert_allclose(states[:, 0, 0], [0.25, 2.0])


def test_an_anchor_of_its_own_duration_starts_the_next_until_its_end(stage: Stage) -> None:
    stage.reply = own_times
    stage.cycle(0.1)
    stage.planner.follow(1)
    stage.now += 0.4
    stage.cycle()

    warm_start = stage.requests[1].warm_start
    assert warm_start is not None
    assert warm_start.dt == pytest.approx(0.5 / 4)  # of 1 s half is left
    np.testing.assert_allclose(warm_start.trajectory[:, 0], [2.0, 2.5, 3.0, 3.5, 4.0])


def test_a_horizon_that_is_asked_for_is_the_warm_starts(stage: Stage) -> None:
    stage.reply = own_times
    stage.cycle(0.1, horizon_s=3.0)
    stage.planner.follow(0)
    stage.cycle(horizon_s=3.0)

    warm_start = stage.requests[1].warm_start
    assert warm_start is not None
    assert warm_start.dt == 0.75
    assert warm_start.trajectory[-1, 0] == pytest.approx((0.1 + 3.0) * 0.5)


def test_a_horizon_that_is_no_number_is_refused_as_ever(stage: Stage) -> None:
    stage.cycle()
    plan = stage.cycle(horizon_s="8")

    assert isinstance(plan.last_error, InvalidRequest)
    assert plan.last_error.field == "horizon_s"


def test_an_anchor_that_is_over_starts_nothing_while_others_go_on(stage: Stage) -> None:
    stage.planner = Planner(
        stage,
        PlannerConfig(max_age_ms=9000.0, cold_every=3),
        clock=lambda: stage.now,
        executor=ByHand(stage.waiting),
    )
    stage.reply = own_times
    stage.cycle(1.0)
    for index, warm in ((1, False), (0, True)):
        stage.planner.follow(index)
        stage.update()
        stage.fail(Overloaded("full"))
        stage.planner.wait(0.0)
        assert (stage.requests[-1].warm_start is not None) == warm
        stage.now += 1.0


def test_a_plan_whose_anchors_are_all_over_is_expired(stage: Stage) -> None:
    stage.reply = lambda request: replace(batch_for(request), dt=np.array([0.05, 0.125]))
    assert stage.cycle(0.49).state is PlanState.FRESH  # the longest lasts 0.5 s

    stage.now += 0.02
    assert stage.planner.wait(0.0).state is PlanState.EXPIRED


def test_without_a_word_from_the_loop_it_starts_from_the_best(stage: Stage) -> None:
    stage.cycle()
    stage.cycle()

    warm_start = stage.requests[1].warm_start
    assert warm_start is not None
    assert warm_start.trajectory[0, 2] == 2.0  # m/s: the second anchor


def test_every_third_request_starts_from_noise(stage: Stage) -> None:
    for _ in range(7):
        stage.cycle()

    cold = [request.warm_start is None for request in stage.requests]
    assert cold == [True, False, False, True, False, False, True]


def test_an_anchor_that_is_used_up_starts_nothing(stage: Stage) -> None:
    stage.cycle()
    stage.now += 5.0  # it lasted 2 s
    stage.cycle()

    assert stage.requests[1].warm_start is None


def test_the_margin_is_sent_and_certified() -> None:
    stage = Stage(PlannerConfig(margin_m=0.07))
    stage.cycle()
    stage.cycle(refine={"project": False, "certified_margin": 0.2})

    first, second = (request.refine for request in stage.requests)
    assert first is not None
    assert first.certified_margin == 0.07
    assert second is not None
    assert (second.project, second.certified_margin) == (False, 0.2)


def test_a_plan_names_its_best_anchor_and_those_of_its_route(stage: Stage) -> None:
    plan = stage.cycle()

    assert plan.best == 1
    assert plan.on_route is not None
    assert plan.on_route.tolist() == [True, True]
    assert plan.reason is None
    assert stage.update(x_curr=[0.0] * 6).batch is not None


def test_an_answer_without_anything_safe_says_why(stage: Stage) -> None:
    def unsafe(request: AnchorRequest) -> AnchorBatch:
        batch = batch_for(request)
        narrow = {"safe": np.zeros(2, bool), "clearance": np.array([-0.1, -0.02], np.float32)}
        return replace(batch, arrays={**batch.arrays, **narrow})

    stage.reply = unsafe
    reason = stage.cycle().reason

    assert reason is not None
    assert "keeps -0.02 m of the 0.00 m" in reason


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


def test_after_a_reset_nothing_old_comes_back(stage: Stage) -> None:
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


@pytest.mark.parametrize(
    ("view", "field"),
    [({"x_curr": np.zeros((2, 6))}, "x_curr"), ({"x_goal": np.zeros((2, 4))}, "x_goal")],
)
def test_a_batch_of_states_is_no_single_robot(
    stage: Stage, view: dict[str, Any], field: str
) -> None:
    with pytest.raises(InvalidRequest, match=f"{field}: expected one vector, got shape"):
        stage.update(**view)


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("max_age_ms", 0.0),
        ("period_ms", float("nan")),
        ("first_retry_ms", -1.0),
        ("warm_tau", 1.0),
        ("cold_every", 0),
        ("through_speed", -1.0),
    ],
)
def test_a_setting_out_of_range_is_named(setting: str, value: float) -> None:
    settings: dict[str, Any] = {setting: value}
    with pytest.raises(ValueError, match=setting):
        PlannerConfig(**settings)


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
