"""Late plans join what the car does until they arrive, on hand-made arcs."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.late import Departure, joined

STEP = 0.1
TIMES = STEP * np.arange(1, 41)
DELAY = 0.3


def arc(times: FloatArray, *, speed: float, pull: float, curvature: float) -> FloatArray:
    """Return the poses [1,T,3] of a car on an arc that pulls away or brakes until it stands."""
    moving = np.minimum(times, -speed / pull if pull < 0 else np.inf)
    way = speed * moving + pull * moving**2 / 2
    turn = curvature * way
    chord = way * np.sinc(turn / 2 / np.pi)
    return np.stack([chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn], -1)[None]


# What the plan does, what the car does until then, and the pull [m/s^2] and curvature [1/m] that
# the late plan may need.
CASES = {
    "goes on": ((10.0, 0.0, 0.0), (10.0, 0.0, 0.0), 1e-6, 1e-6),
    "bends on": ((10.0, 0.0, 0.03), (10.0, 0.0, 0.03), 0.1, 0.032),
    "pulls away": ((6.0, 2.0, 0.0), (6.0, 0.0, 0.0), 2.5, 1e-6),
    "from rest": ((0.0, 1.5, 0.0), (0.0, 0.0, 0.0), 2.1, 1e-6),
    "brakes": ((10.0, -3.0, 0.0), (10.0, 0.0, 0.0), 5.1, 1e-6),
    "brakes hard in a bend": ((8.0, -5.0, 0.05), (8.0, 0.0, 0.0), 8.0, 0.15),
    "turns in": ((6.0, 0.0, 0.1), (6.0, 0.0, 0.0), 2.2, 0.16),
    "lets go of the brake": ((9.0, 0.0, 0.0), (9.0, -4.0, 0.0), 1.0, 1e-6),
    "straightens": ((12.0, -1.0, 0.0), (12.0, 1.0, 0.05), 3.1, 0.06),
}


@pytest.mark.parametrize("case", CASES)
def test_a_late_plan_goes_on_from_where_the_car_is_and_can_be_driven(case: str) -> None:
    (speed, pull, curvature), (_, until, bend), most_pull, sharpest = CASES[case]
    plan = arc(TIMES, speed=speed, pull=pull, curvature=curvature)
    meanwhile = arc(np.linspace(0.0, 0.5, 6), speed=speed, pull=until, curvature=bend)[0]
    rows = np.c_[np.linspace(0.0, 0.5, 6), meanwhile]
    departure = Departure.along(DELAY, rows, speed=speed)
    np.testing.assert_allclose(departure.pose, meanwhile[3], atol=2e-3)
    assert departure.speed == pytest.approx(speed + until * DELAY, abs=0.02)

    (late,) = joined(plan, TIMES, speed=speed, departure=departure)

    poses = np.concatenate([departure.pose[None], late])
    moved = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    speeds = np.concatenate([[departure.speed], moved / STEP])
    pulls = np.diff(speeds) / np.r_[STEP / 2, np.full(len(TIMES) - 1, STEP)]
    assert np.abs(pulls).max() < most_pull
    turns = np.abs(np.diff(np.unwrap(poses[:, 2])))
    assert (turns <= sharpest * moved + 2e-3).all()
    ahead = np.diff(poses[:, :2], axis=0)
    middle = poses[:-1, 2] + np.diff(poses[:, 2]) / 2
    aside = ahead[:, 1] * np.cos(middle) - ahead[:, 0] * np.sin(middle)
    assert np.abs(aside).max() < 0.02  # it does not slip


def test_a_late_plan_comes_back_to_its_path_and_catches_up_only_with_a_stop() -> None:
    departure = Departure.at_constant_rates(DELAY, speed=10.0, yaw_rate=0.0)
    bend, stop, pull = (
        joined(arc(TIMES, speed=10.0, pull=a, curvature=c), TIMES, speed=10.0, departure=departure)
        for a, c in ((0.0, 0.03), (-3.0, 0.0), (1.0, 0.0))
    )
    radius = np.hypot(bend[0, :, 0], bend[0, :, 1] - 1 / 0.03)
    assert radius[0] > 1 / 0.03 + 0.1
    np.testing.assert_allclose(radius[20:30], 1 / 0.03, atol=0.02)
    where = arc(TIMES[-1:], speed=10.0, pull=-3.0, curvature=0.0)[0, 0, 0]
    assert where <= stop[0, -1, 0] < where + 0.3
    on_time = arc(TIMES + DELAY, speed=10.0, pull=1.0, curvature=0.0)[0, -1, 0]
    assert on_time - 2.0 < pull[0, -1, 0] < on_time


def test_a_delay_of_nothing_leaves_plans_as_they_are_and_each_alone() -> None:
    plans = np.concatenate(
        [arc(TIMES, speed=7.0, pull=a, curvature=c) for a, c in ((1.0, 0.05), (-2.0, 0.0))]
    )
    now = Departure.at_constant_rates(1e-9, speed=7.0, yaw_rate=0.0)
    np.testing.assert_allclose(joined(plans, TIMES, speed=7.0, departure=now), plans, atol=0.02)
    then = Departure.at_constant_rates(DELAY, speed=7.0, yaw_rate=0.1)
    both = joined(plans, TIMES, speed=7.0, departure=then)
    alone = joined(plans[1:], TIMES, speed=7.0, departure=then)
    np.testing.assert_array_equal(both[1:], alone)


def test_the_car_follows_its_last_plan_from_wherever_it_is_beside_it() -> None:
    rows = np.array([[-0.5, -4.0, 1.0, 0.1], [0.0, 1.0, 1.0, 0.1], [1.0, 11.0, 1.0, 0.1]])
    departure = Departure.along(0.5, rows, speed=0.0)
    np.testing.assert_allclose(departure.pose, [5 * np.cos(0.1), -5 * np.sin(0.1), 0.0], atol=1e-9)
    assert departure.speed == pytest.approx(10 * np.cos(0.1))
    coming = Departure.along(0.2, np.array([[0.4, 4.0, 0.0, 0.0], [0.8, 8.0, 0.0, 0.0]]), speed=10)
    np.testing.assert_allclose(coming.pose, [2.0, 0.0, 0.0], atol=1e-9)
