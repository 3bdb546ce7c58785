"""The start of the next request, the end of an anchor in use, and an anchor seen later."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from staged_planner import DT, ByHand, Stage, batch_for

from anchorflow_client import AnchorBatch, AnchorRequest, InvalidRequest, Overloaded
from anchorflow_client.planner import Planner, PlannerConfig
from anchorflow_client.planner.plan import PlanState, shifted, states_of


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
    """Return the same anchors: the first lasts 4 s, the second 1 s."""
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


def test_requests_start_from_the_best_and_every_third_from_noise(stage: Stage) -> None:
    for _ in range(7):
        stage.cycle()

    starts = [request.warm_start for request in stage.requests]
    assert [start is None for start in starts] == [True, False, False, True, False, False, True]
    assert starts[1] is not None
    assert starts[1].trajectory[0, 2] == 2.0  # m/s: the second anchor, which is the best


def test_an_anchor_that_has_ended_starts_no_request(stage: Stage) -> None:
    stage.cycle()
    stage.now += 5.0  # it lasted 2 s
    stage.cycle()

    assert stage.requests[1].warm_start is None


SAMPLE_S = 0.1


def falling(times: np.ndarray) -> np.ndarray:
    """[T,6]: constant acceleration of 2 m/s^2 along y, 1 m/s along x."""
    t, zero = times, np.zeros_like(times)
    return np.stack([t, t**2, zero + 1, 2 * t, zero, zero + 2], axis=-1)


@given(st.floats(0.0, 0.9))
def test_between_samples_the_error_is_that_of_a_chord(elapsed_s: float) -> None:
    times = SAMPLE_S * np.arange(20)
    later = shifted(falling(times), dt=SAMPLE_S, elapsed_s=elapsed_s)
    left = times + elapsed_s <= times[-1]
    error = np.abs(later - falling(times + elapsed_s))[left]
    assert error.max() <= 2 * SAMPLE_S**2 / 8 + 1e-9  # |a| dt^2 / 8


def test_past_its_end_the_motion_goes_on_straight() -> None:
    states = falling(SAMPLE_S * np.arange(11))  # ends at (1, 1) with (1, 2) m/s
    later = shifted(states, dt=SAMPLE_S, elapsed_s=1.5)
    np.testing.assert_allclose(later[0], [1.5, 2.0, 1, 2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(later[-1], [2.5, 4.0, 1, 2, 0, 0], atol=1e-12)


@pytest.mark.parametrize("own", [SAMPLE_S, np.array([0.03, 0.1, 0.7])])
def test_anchors_of_a_batch_are_shifted_one_by_one(own: float | np.ndarray) -> None:
    states = np.random.default_rng(0).normal(size=(3, 12, 6))
    together = shifted(states, dt=own, elapsed_s=0.37)
    for one, dt, alone in zip(states, np.broadcast_to(own, 3), together, strict=True):
        np.testing.assert_array_equal(shifted(one, dt=dt, elapsed_s=0.37), alone)


def test_what_is_left_may_be_sampled_up_to_its_end() -> None:
    times = SAMPLE_S * np.arange(11)  # 1 s
    left = shifted(falling(times), dt=SAMPLE_S, elapsed_s=0.4, later_dt=0.06)
    np.testing.assert_allclose(left[[0, -1]], falling(np.array([0.4, 1.0])), atol=1e-9)
    np.testing.assert_allclose(left[5], falling(np.array([0.7]))[0], atol=1e-9)


@given(st.integers(2, 64), st.floats(1e-3, 10.0), st.floats(0.0, 0.999))
def test_the_end_keeps_its_acceleration(steps: int, dt: float, share: float) -> None:
    """However the times are rounded, no sample is past the end."""
    states = falling(dt * np.arange(steps))
    elapsed_s = share * dt * (steps - 1)
    later_dt = (dt * (steps - 1) - elapsed_s) / (steps - 1)
    left = shifted(states, dt=dt, elapsed_s=elapsed_s, later_dt=later_dt)
    np.testing.assert_array_equal(left[:, 4:], states[:, 4:])
    np.testing.assert_allclose(left[-1], states[-1], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_positions_follow_their_own_velocities(dim: int) -> None:
    states = np.zeros((4, 3 * dim))
    states[:, dim : 2 * dim] = np.arange(1, dim + 1)
    later = shifted(states, dt=1.0, elapsed_s=5.0)
    np.testing.assert_allclose(later[0, :dim], 2.0 * np.arange(1, dim + 1))
