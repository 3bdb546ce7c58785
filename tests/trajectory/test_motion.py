"""The law of time along a path: closed forms of its duration, speeds and ramps."""

import numpy as np
import pytest

from anchorflow_trajectory.motion import (
    CRUISE,
    LEAST_RAMP,
    MotionLimits,
    nominal_duration,
    ramp_share,
    time_along,
)

LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
LINE = np.array([[0.0, 0.0], [10.0, 0.0]])


def speeds(length: float, duration: float, ramp: float) -> tuple[float, float]:
    """The largest speed and acceleration along a line of `length` m, from rest to rest."""
    x = length * time_along(LINE, 8001, ramp=ramp)[:, 0].astype(np.float64) / 10.0
    # Over 40 samples at a time: positions are float32.
    step = 40 * duration / 8000
    velocity = np.diff(x[::40]) / step
    return velocity.max(), np.abs(np.diff(velocity) / step).max()


@pytest.mark.parametrize("length", [0.5, 1.0, 5.0, 30.0])
@pytest.mark.parametrize(
    "limits", [LIMITS, MotionLimits(v_max=0.5, a_max=0.25), MotionLimits(v_max=6.0, a_max=8.0)]
)
def test_the_nominal_duration_reaches_a_limit_and_keeps_both(
    length: float, limits: MotionLimits
) -> None:
    duration = nominal_duration(length, limits)
    share = ramp_share(duration, length, limits)
    fastest, hardest = speeds(length, duration, share)
    # The rest of a long path makes up for the shortest ramp.
    most = CRUISE if share > LEAST_RAMP else CRUISE / (1.0 - LEAST_RAMP)
    assert fastest <= 1.005 * most * limits.v_max
    assert hardest <= 1.01 * limits.a_max
    cruises = fastest > 0.99 * CRUISE * limits.v_max
    assert cruises or hardest > 0.97 * limits.a_max
    # No quicker than the bang-bang law that has no ramps to smooth.
    assert duration >= limits.least_time(length)


def test_the_nominal_duration_is_ramps_and_a_cruise() -> None:
    ramp = 0.5 * np.pi * 1.8 / 3.0  # to 1.8 m/s with a_max in its middle
    assert nominal_duration(9.0, LIMITS) == pytest.approx(9.0 / 1.8 + ramp)
    # Where both meet nothing jumps: the cruise is as short as it can be.
    meet = 1.8 * ramp
    below, above = (nominal_duration(meet * (1 + s * 1e-9), LIMITS) for s in (-1, 1))
    assert below == pytest.approx(2 * ramp, rel=1e-6)
    assert above == pytest.approx(below, rel=1e-6)
    assert nominal_duration(0.0, LIMITS) == 0.0


def test_a_pace_slows_the_cruise_down() -> None:
    quick, slow = (nominal_duration(40.0, LIMITS, pace=pace) for pace in (1.0, 1.6))
    cruise = 1.8 / 1.6
    assert slow == pytest.approx(40.0 / cruise + 0.5 * np.pi * cruise / 3.0)
    assert slow > 1.5 * quick


def test_half_the_speed_and_a_quarter_of_the_acceleration_take_twice_as_long() -> None:
    slower = MotionLimits(v_max=1.0, a_max=0.75)
    for length in (0.3, 3.0, 30.0):
        for pace in (1.0, 1.4):
            twice = 2.0 * nominal_duration(length, LIMITS, pace=pace)
            assert nominal_duration(length, slower, pace=pace) == pytest.approx(twice)
        assert slower.least_time(length) == pytest.approx(2.0 * LIMITS.least_time(length))
        assert ramp_share(2 * 4.0, length, slower) == pytest.approx(ramp_share(4.0, length, LIMITS))


def test_the_least_time_is_that_of_full_pushes() -> None:
    """Half the way with a_max, half against it; beyond v_max^2 / a_max with a cruise between."""
    assert LIMITS.least_time(0.75) == pytest.approx(2 * (0.75 / 3.0) ** 0.5)
    assert LIMITS.least_time(10.0) == pytest.approx(2 * (2.0 / 3.0) + (10.0 - 4.0 / 3.0) / 2.0)
    assert LIMITS.least_time(4.0 / 3.0) == pytest.approx(LIMITS.least_time(4.0 / 3.0 + 1e-9))
    assert LIMITS.least_time(0.0) == LIMITS.least_time(-1.0) == 0.0


@pytest.mark.parametrize("length", [0.5, 3.0, 8.0])
@pytest.mark.parametrize("longer", [1.0, 1.3, 3.0])
def test_ramps_keep_the_acceleration_in_every_duration_that_allows_it(
    length: float, longer: float
) -> None:
    duration = longer * nominal_duration(length, LIMITS)
    share = ramp_share(duration, length, LIMITS)
    assert LEAST_RAMP <= share <= 0.5
    _, hardest = speeds(length, duration, share)
    assert hardest <= 1.01 * LIMITS.a_max
    if share > LEAST_RAMP:  # and no ramp is longer than that needs
        assert hardest > 0.97 * LIMITS.a_max


def test_where_the_time_is_too_short_a_ramp_takes_half_of_it() -> None:
    assert ramp_share(1.0, 8.0, LIMITS) == 0.5


@pytest.mark.parametrize(("first", "last"), [(0.0, 0.0), (0.6, 0.0), (0.0, 0.9), (1.3, 0.2)])
@pytest.mark.parametrize("ramp", [0.12, 0.18, 0.4])
def test_the_law_has_the_speeds_that_are_asked_and_a_cruise_between(
    first: float, last: float, ramp: float
) -> None:
    x = time_along(LINE, 4001, ramp=ramp, start_share=first, goal_share=last)[:, 0]
    speed = np.diff(x.astype(np.float64)) * 4000 / 10.0  # in shares of the mean

    assert (x[0], x[-1]) == (0.0, 10.0)
    assert speed[:20].mean() == pytest.approx(first, abs=0.02)
    assert speed[-20:].mean() == pytest.approx(last, abs=0.02)
    cruise = (1.0 - 0.5 * ramp * (first + last)) / (1.0 - ramp)
    assert speed[1700:2300].mean() == pytest.approx(cruise, abs=0.01)


def test_a_law_that_leaves_nothing_to_the_cruise_never_turns_back() -> None:
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    x = time_along(line, 401, ramp=0.18, start_share=9.0, goal_share=9.0)[:, 0]

    assert (np.diff(x) >= 0.0).all()
    assert (x[0], x[-1]) == (0.0, 1.0)
