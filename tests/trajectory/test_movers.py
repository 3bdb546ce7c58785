"""The clearance to discs that move is a lower bound, and a close one, in continuous time."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest
from crowd_judge import Crowd
from scipy.interpolate import BSpline

from anchorflow_trajectory.movers import Discs, MovingDiscs, moving_clearance
from anchorflow_trajectory.spline.basis import Ends, SplineBasis, spline_basis

V_MAX, A_MAX = 2.0, 3.0
MOTIONS = 200
COARSE = 60.0  # s, of which 64 samples see every second
OVER = 1e-3  # m that a bound may be above the truth
UNDER = {"usual": 0.03, "coarse": 0.1}  # m that it may be below, more where a leg lasts a second
BASIS = spline_basis(64, num_control_points=18)
FINER = BASIS.finer
assert FINER is not None


def motion(basis: SplineBasis, rng: np.random.Generator, duration: float) -> BSpline:
    """Return a bent motion by the time in s, within both limits."""
    degree, count = basis.degree, basis.num_control_points
    inner = np.linspace(0.0, duration, count - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.full(degree, duration)])
    while True:
        way = rng.uniform(1.0, min(0.6 * V_MAX * duration, 30.0))
        start = np.concatenate([[-way / 2, 0.0], rng.normal(0.0, 0.5, 4)])
        ends = Ends(start, np.concatenate([[way / 2, 0.0], rng.normal(0.0, 0.3, 2)]))
        control = basis.rest_curves(ends, np.array([duration])).control[:, 0].astype(float)
        free = control[:, basis.free]
        bulge = np.sin(np.linspace(0.0, np.pi, free.shape[1]))
        free += rng.normal(0.0, rng.uniform(0.0, 0.05) * way, free.shape) * bulge
        curve = BSpline(knots, control.T, degree)
        times = np.linspace(0.0, duration, 200)
        speed, push = (np.linalg.norm(curve(times, nu=n), axis=-1).max() for n in (1, 2))
        if speed <= V_MAX and push <= A_MAX:
            return curve


def crowd_near(curve: BSpline, rng: np.random.Generator, kind: str) -> dict[str, Any]:
    """Return the fields of a few discs that come close to a motion."""
    duration, count = curve.t[-1], int(rng.integers(1, 6))
    meeting = rng.uniform(0.0, duration, count)
    velocity = rng.normal(0.0, 1.0, (count, 2))
    fields: dict[str, Any] = {"velocity": velocity, "growth": 0.2 if kind == "growth" else 0.0}
    if kind == "forecast":
        step, legs = float(rng.choice([0.1, 0.4, 1.0, 3.0])), int(rng.integers(1, 30))
        ahead = np.cumsum(rng.normal(0.0, step, (count, legs, 2)), axis=1)
        fields = {"forecast": ahead, "forecast_dt": step}
    there = np.diagonal(Crowd.of(np.zeros((count, 2)), **fields).places(meeting), axis1=0, axis2=1)
    position = curve(meeting) + rng.normal(0.0, 0.6, (count, 2)) - there.T
    if kind == "forecast":
        fields["forecast"] = fields["forecast"] + position[:, None]
    return {"position": position, "radius": rng.uniform(0.1, 0.6, count), **fields}


@numba.njit
def clearance(discs: Any, path: Any, duration: float, enough: float, most: float) -> float:
    return moving_clearance(discs, path, duration, enough, most)


@pytest.mark.parametrize("kind", ["velocity", "forecast", "growth"])
@pytest.mark.parametrize("lasting", ["usual", "coarse"])
@pytest.mark.parametrize("basis", [BASIS, FINER], ids=["basis", "finer basis"])
def test_clearance_is_a_close_lower_bound(basis: SplineBasis, lasting: str, kind: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(MOTIONS):
        duration = COARSE if lasting == "coarse" else rng.uniform(2.0, 10.0)
        curve = motion(basis, rng, duration)
        fields = crowd_near(curve, rng, kind)
        crowd = Crowd.of(**fields)
        given: dict[str, Any] = {"velocity": None} | fields
        movers = MovingDiscs.of(**given)
        times = np.linspace(0.0, duration, basis.num_samples)
        path = np.ascontiguousarray(curve(times), np.float32)

        bound = clearance(Discs.of(movers, np.float64), path, duration, -np.inf, np.inf)

        dense = crowd.dense(duration, duration / 2000)
        true = crowd.gap(dense, curve(dense))
        grown = crowd.growth * times[1]  # of a leg, whose radius is that at its end
        assert true - UNDER[lasting] - grown <= bound <= true + OVER


def test_it_stops_below_what_is_enough_and_tells_no_more_than_asked() -> None:
    movers = MovingDiscs.of(np.array([[0.0, 2.0]]), np.zeros((1, 2)), np.full(1, 0.5))
    path = np.stack([np.linspace(-3.0, 3.0, 64), np.zeros(64)], -1)
    discs = Discs.of(movers, np.float64)
    assert clearance(discs, path, 5.0, -np.inf, np.inf) == pytest.approx(1.5, abs=1e-3)
    assert clearance(discs, path, 5.0, 0.1, 0.1) == 0.1
    assert 1.5 - 1e-3 <= clearance(discs, path, 5.0, 2.0, 2.0) < 2.0


@pytest.mark.parametrize("legs", [1, 3])
@pytest.mark.parametrize("at", [0, 7, 63])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_motion_without_numbers_has_no_clearance(value: float, at: int, legs: int) -> None:
    movers = MovingDiscs.of(
        np.full((1, 2), 9.0),
        None,
        np.full(1, 0.5),
        forecast=np.full((1, legs, 2), 9.0),
        forecast_dt=1,
    )
    path = np.zeros((64, 2))
    path[at, 1] = value
    assert not clearance(Discs.of(movers, np.float64), path, 5.0, 0.1, 0.1) >= 0.1
