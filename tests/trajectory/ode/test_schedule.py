"""The times of the stages, and which schedules are none."""

from itertools import pairwise

import numpy as np
import pytest

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE, uniform_schedule
from anchorflow_trajectory.ode.methods import EULER, METHODS, RK4, Method
from anchorflow_trajectory.ode.schedule import check_schedule, remaining, stage_strides, stage_times

EACH_METHOD = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)


def test_rk4_on_eight_steps_has_seventeen_distinct_times() -> None:
    plan = stage_times(RK4, EIGHT_STEP_SCHEDULE)
    assert plan.times.shape == (17,)
    assert plan.times.dtype == np.float32
    assert (np.diff(plan.times) > 0).all()
    assert plan.index[0] == (0, 1, 1, 2)
    assert plan.index[-1] == (14, 15, 15, 16)


@EACH_METHOD
@pytest.mark.parametrize(
    "schedule", [EIGHT_STEP_SCHEDULE, uniform_schedule(7)], ids=["8step", "uniform"]
)
def test_stage_times_are_where_the_method_says(method: Method, schedule: tuple[float, ...]) -> None:
    plan = stage_times(method, schedule)
    expected = [[t + c * (e - t) for c in method.c] for t, e in pairwise(schedule)]
    np.testing.assert_allclose(plan.times[np.array(plan.index)], expected, atol=1e-7)


def test_euler_never_evaluates_at_the_end() -> None:
    assert stage_times(EULER, uniform_schedule(4)).times.tolist() == [0.0, 0.25, 0.5, 0.75]


def test_a_stage_time_has_the_stride_of_the_longest_step_that_asks_there() -> None:
    """RK4 asks at the ends and the middle of each step, and steps share their ends."""
    strides = stage_strides(RK4, (0.0, 0.8, 0.9, 1.0))
    assert strides == pytest.approx((0.8, 0.8, 0.8, 0.1, 0.1, 0.1, 0.1))
    assert stage_strides(EULER, (0.0, 0.8, 1.0)) == pytest.approx((0.8, 0.2))


@pytest.mark.parametrize(
    "schedule", [(1.0,), (0.0, 0.5, 0.5, 1.0), (0.0, 0.9), (0.5, 0.2, 1.0), (-0.1, 1.0)]
)
def test_schedules_that_do_not_rise_to_one_are_refused(schedule: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="strictly rising to 1"):
        check_schedule(schedule)


def test_what_remains_of_a_schedule() -> None:
    assert remaining(EIGHT_STEP_SCHEDULE, 0.8) == EIGHT_STEP_SCHEDULE[1:]
    assert remaining(EIGHT_STEP_SCHEDULE, 0.91) == (0.91, *EIGHT_STEP_SCHEDULE[4:])
