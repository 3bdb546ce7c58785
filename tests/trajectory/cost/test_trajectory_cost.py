"""The cost is what its docstring says, its hand-written gradient equals finite differences to
their own precision, and a slower robot in its own time is asked the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from crowd_judge import Crowd

from anchorflow_trajectory.cost.kernels import MET
from anchorflow_trajectory.cost.trajectory_cost import CostWeights, TrajectoryCost
from anchorflow_trajectory.motion import TURN, MotionLimits
from anchorflow_trajectory.movers import MovingDiscs
from anchorflow_trajectory.spline.basis import Splines

GAINS = (
    "time",
    "safety",
    "slow",
    "quick",
    "short",
    "smooth",
    "dear",
    "collision",
    "speed",
    "acceleration",
)
STYLE_OF = {"safety": 0, "slow": 0, "quick": 1, "short": 1, "smooth": 2}
CORNERS = np.eye(3)
STYLES = (*CORNERS, np.array([0.4, 0.3, 0.3]), np.array([0.1, 0.7, 0.2]))
REFERENCE_S = 2.9
FAST = 2.0  # s, in which disturbed curves break every limit


@pytest.fixture
def make_cost(stage: Any) -> Callable[..., TrajectoryCost]:
    def make(
        style: np.ndarray,
        *,
        risky: bool = True,
        weights: CostWeights | None = None,
        movers: MovingDiscs | None = None,
    ) -> TrajectoryCost:
        return TrajectoryCost(
            stage.basis,
            replace(stage.fields(risky=risky), movers=movers),
            stage.limits,
            style,
            REFERENCE_S,
            0.08,
            weights or CostWeights(),
        )

    return make


def with_heading(splines: Splines) -> Splines:
    """[3, M, K] with a third dimension in rad."""
    heading = np.random.default_rng(4).normal(0.0, 0.5, splines.control[:1].shape)
    return Splines(np.concatenate([splines.control, heading]), splines.duration)


def only(gain: str) -> CostWeights:
    """Weights with a single term."""
    return replace(CostWeights(), **{name: 0.0 for name in GAINS if name != gain})


def told(problem: TrajectoryCost, splines: Splines) -> dict[str, np.ndarray]:
    """The terms of J [M] of the module's docstring, before weighting."""
    basis, limits, duration = problem.basis, problem.limits, splines.duration
    rows = (basis.position, basis.velocity, basis.acceleration, basis.jerk)
    p, first, second, third = (splines.control @ row.T.astype(np.float64) for row in rows)
    v, a, jerk = (x / duration[:, None] ** k for k, x in enumerate((first, second, third), 1))
    clearance = problem.fields.clearance.sample(p[0], p[1])
    near = np.maximum(1 - clearance / 0.6, 0) ** 2
    price = np.zeros_like(near)
    if problem.fields.surcharge is not None:
        price = 1 + problem.fields.surcharge.sample(p[0], p[1])
    hard = np.maximum(problem.margin - clearance, 0)
    speed, push = (np.hypot(x[0], x[1]) for x in (v, a))
    way = limits.v_max * problem.reference_s
    terms = {
        "safety": near,
        "slow": (v**2).sum(0) / limits.v_max**2,
        "short": (first**2).sum(0) / way**2,
        "smooth": (jerk**2).sum(0) / limits.jerk_scale**2,
        "dear": price * np.hypot(first[0], first[1]) / way,
        "collision": np.where(hard > 0.25, 0.25 * (2 * hard - 0.25), hard**2),
        "speed": np.maximum(speed / limits.v_max - 0.97, 0) ** 2,
        "acceleration": np.maximum(push / limits.a_max - 0.97, 0) ** 2,
    }
    lasting = duration / problem.reference_s
    return {name: term.mean(-1) for name, term in terms.items()} | {
        "time": lasting,
        "quick": lasting,
    }


@pytest.mark.parametrize("style", STYLES, ids=str)
@pytest.mark.parametrize("risky", [False, True])
def test_the_cost_is_what_the_docstring_says(
    make_cost: Callable[..., TrajectoryCost], stage: Any, style: np.ndarray, risky: bool
) -> None:
    problem = make_cost(style, risky=risky)
    splines = with_heading(stage.disturbed(6, stage.moving, spread=1.0, duration=FAST))
    terms = told(problem, splines)
    assert {field.name for field in fields(CostWeights)} >= set(GAINS) == set(terms)
    assert all((term > 0).any() for name, term in terms.items() if risky or name != "dear")
    w, cubed = problem.weights, style**3 / (style**3).sum()
    share = {name: cubed[STYLE_OF[name]] if name in STYLE_OF else 1.0 for name in GAINS}
    expected = sum(share[name] * getattr(w, name) * terms[name] for name in GAINS)
    np.testing.assert_allclose(problem.value(splines), expected, rtol=2e-6)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("gain", "risky"),
    [*((gain, True) for gain in GAINS), *((g, False) for g in GAINS if g != "dear")],
)
def test_each_terms_gradient_equals_finite_differences(
    make_cost: Callable[..., TrajectoryCost], stage: Any, gain: str, risky: bool, dim: int
) -> None:
    """Term by term, because beside the hinges at 400 a style of 8 is not seen."""
    problem = make_cost(CORNERS[STYLE_OF.get(gain, 0)], risky=risky, weights=only(gain))
    splines = stage.disturbed(6, stage.moving, spread=1.0, duration=FAST)
    assert_gradient(problem, with_heading(splines) if dim == 3 else splines)


def crowd(kind: str) -> tuple[Crowd, MovingDiscs]:
    """Twelve discs about both ends of the stage, which the curves meet and touch."""
    rng = np.random.default_rng(6)
    position, radius = rng.uniform([0.5, 2.2], [6.0, 4.2], (12, 2)), rng.uniform(0.3, 0.6, 12)
    velocity = rng.normal(0.0, 0.8, (12, 2))
    if kind == "velocity":
        return (
            Crowd.of(position, velocity, radius, growth=0.1),
            MovingDiscs.of(position, velocity, radius, growth=0.1),
        )
    ahead = position[:, None] + np.cumsum(rng.normal(0.0, 0.3, (12, 4, 2)), axis=1)
    told: dict[str, Any] = {"forecast": ahead, "forecast_dt": 0.37, "growth": 0.05}
    return Crowd.of(position, None, radius, **told), MovingDiscs.of(position, None, radius, **told)


@pytest.mark.parametrize("style", STYLES, ids=str)
@pytest.mark.parametrize("kind", ["velocity", "forecast"])
def test_nearness_to_what_moves_costs_what_the_docstring_says(
    make_cost: Callable[..., TrajectoryCost], stage: Any, kind: str, style: np.ndarray
) -> None:
    discs, movers = crowd(kind)
    problem = make_cost(style, movers=movers)
    splines = stage.disturbed(6, stage.moving, spread=1.0, duration=FAST)
    w, lean = problem.weights, (style**3 / (style**3).sum())[0]
    expected = []
    for control, lasting in zip(splines.control.swapaxes(0, 1), splines.duration, strict=True):
        path = (control @ stage.basis.position.T.astype(float)).T
        time = np.linspace(0.0, lasting, len(path))
        apart = np.linalg.norm(path - discs.places(time), axis=-1)
        gap = apart - discs.radius[:, None] - discs.growth * time
        hard = np.maximum(problem.margin - gap, 0.0)
        lack = np.maximum(1.0 - gap / (w.distance + w.widening * time), 0.0)
        near = w.near * (1.0 + lean) / (1.0 + w.fading * time) * lack**2
        touch = w.collision * np.where(hard > 0.25, 0.25 * (2 * hard - 0.25), hard**2)
        assert (hard > 0.25).any()
        expected.append(w.per_s * lasting * (near + touch).sum(0)[1::MET].mean())
    found = problem.value(splines) - replace(problem, fields=stage.fields(risky=True)).value(
        splines
    )
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["velocity", "forecast"])
@pytest.mark.parametrize("gain", ["near", "collision"])
def test_the_gradient_with_what_moves_equals_finite_differences(
    make_cost: Callable[..., TrajectoryCost], stage: Any, gain: str, kind: str, dim: int
) -> None:
    weights = replace(only(gain), near=CostWeights().near if gain == "near" else 0.0)
    _, movers = crowd(kind)
    problem = make_cost(STYLES[3], risky=False, weights=weights, movers=movers)
    splines = stage.disturbed(6, stage.moving, spread=1.0, duration=FAST)
    assert_gradient(problem, with_heading(splines) if dim == 3 else splines)


def assert_gradient(problem: TrajectoryCost, splines: Splines) -> None:
    """Differences by control points over 1e-6 m, and by log duration in float32 arithmetic."""
    control, duration = splines.control, splines.duration
    h, rng = 1e-6, np.random.default_rng(5)
    _, gradient = problem.value_and_gradient(splines)
    assert max(np.abs(part).max() for part in gradient) > 1e-3
    for _ in range(8):
        direction = rng.normal(size=control.shape)
        ahead, behind = (
            problem.value(Splines(control + s * h * direction, duration)) for s in (1, -1)
        )
        slope = (gradient.control * direction).sum((0, 2))
        scale = np.abs(gradient.control).max() * np.abs(direction).max()
        np.testing.assert_allclose(
            (ahead - behind) / (2 * h), slope, atol=1e-7 * scale + 1e-12, rtol=1e-6
        )
    h = 1e-3
    ahead, behind = (problem.value(Splines(control, duration * np.exp(s * h))) for s in (1, -1))
    assert_slopes((ahead - behind) / (2 * h), gradient.log_duration)


def assert_slopes(difference: np.ndarray, slope: np.ndarray) -> None:
    """Equal to 1e-3 of the largest, at which a term that is missing shows."""
    np.testing.assert_allclose(difference, slope, atol=1e-3 * np.abs(slope).max(), rtol=1e-3)


@pytest.mark.parametrize("ends", ["moving", "at_rest"])
def test_moving_ends_count_in_the_slope_by_duration(
    make_cost: Callable[..., TrajectoryCost], stage: Any, ends: str
) -> None:
    """The slope of J along curves that meet both ends in every duration, as in the descent."""
    between, problem = getattr(stage, ends), make_cost(STYLES[3])
    splines = stage.disturbed(6, between, spread=0.6, duration=FAST)
    free, h = stage.basis.free, 1e-3

    def lasting(duration: np.ndarray) -> Splines:
        control = stage.basis.end_points(between, duration).astype(np.float64)
        control[..., free] = splines.control[..., free]
        return Splines(control, duration)

    ahead, behind = (problem.value(lasting(splines.duration * np.exp(s * h))) for s in (1, -1))
    _, gradient = problem.value_and_gradient(lasting(splines.duration))
    ending = stage.basis.end_slopes(between, splines.duration)
    by_ends = np.einsum("dmk,dmk->m", gradient.control, ending)
    assert (np.abs(by_ends).max() > 0.1) == (ends == "moving")
    assert_slopes((ahead - behind) / (2 * h), gradient.log_duration + by_ends)


@pytest.mark.parametrize("slower", [2.0, 4.0])
def test_a_slower_robot_in_its_own_time_is_asked_the_same(
    make_cost: Callable[..., TrajectoryCost], stage: Any, slower: float
) -> None:
    """v_max / k and a_max / k^2 in k times the durations: the same J and the same slopes."""
    problem = make_cost(STYLES[3])
    splines = stage.disturbed(6, stage.moving, spread=1.0, duration=FAST)
    limits = MotionLimits(stage.limits.v_max / slower, stage.limits.a_max / slower**2)
    assert limits.jerk_scale == pytest.approx(stage.limits.jerk_scale / slower**3)
    other = replace(problem, limits=limits, reference_s=slower * REFERENCE_S)
    cost, slopes = problem.value_and_gradient(splines)
    same, also = other.value_and_gradient(Splines(splines.control, slower * splines.duration))
    np.testing.assert_allclose(same, cost, rtol=1e-5)
    for part, other_part in zip(slopes, also, strict=True):
        np.testing.assert_allclose(other_part, part, rtol=1e-4, atol=1e-5 * np.abs(part).max())


def test_states_last_as_long_as_they_say_or_as_the_horizon() -> None:
    states = np.random.default_rng(0).normal(size=(3, 8, 7)).astype(np.float32)
    states[..., -1] = np.log([[2.0], [3.0], [4.0]])
    states[0, ::2, -1], states[0, 1::2, -1] = np.log(1.0), np.log(4.0)
    free, fixed = MotionLimits(2.0, 3.0), MotionLimits(2.0, 3.0, horizon_s=7.0)
    np.testing.assert_allclose(free.durations(states), [2.0, 3.0, 4.0], rtol=1e-6)
    assert fixed.durations(states).tolist() == [7.0] * 3


def test_jerk_is_measured_by_the_gentler_of_two_ramps() -> None:
    """The scale follows a weak a_max, else reaching v_max within TURN metres."""
    assert MotionLimits(2.0, 1.5).jerk_scale == pytest.approx(1.5**2 / 2.0)
    agile = MotionLimits(2.0, 100.0)
    assert agile.jerk_scale == pytest.approx((2.0**2 / TURN) ** 2 / 2.0)


def test_each_trajectory_may_have_its_own_style(
    make_cost: Callable[..., TrajectoryCost], stage: Any
) -> None:
    splines, styles = stage.disturbed(5, stage.moving, spread=1.0), np.stack(STYLES)
    value, gradient = make_cost(styles).value_and_gradient(splines)
    for m, style in enumerate(STYLES):
        one, slope = make_cost(style).value_and_gradient(splines[m : m + 1])
        np.testing.assert_allclose(value[m : m + 1], one, rtol=1e-6)
        np.testing.assert_allclose(
            gradient.control[:, m : m + 1], slope.control, rtol=1e-6, atol=1e-6
        )
        np.testing.assert_allclose(gradient.log_duration[m], slope.log_duration[0], rtol=1e-6)


def test_leaning_keeps_the_corners_and_the_middle() -> None:
    weights = CostWeights()
    for style in (*CORNERS, np.full(3, 1 / 3)):
        np.testing.assert_allclose(weights.leaning(style), style)
    leaning = weights.leaning(np.array([0.5, 0.25, 0.25]))
    np.testing.assert_allclose(leaning, np.array([8, 1, 1]) / 10)
    np.testing.assert_allclose(weights.leaning(np.eye(3)[[2, 0]]), np.eye(3)[[2, 0]].T)
