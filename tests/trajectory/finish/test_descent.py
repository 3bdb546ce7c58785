"""Descent does what it is for: free, within the limits, as long as it takes, each on its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.finish.certificate import path_clearance, verify
from anchorflow_trajectory.finish.descent import descend
from anchorflow_trajectory.spline.basis import Ends, Splines, whitening

BALANCED = (0.4, 0.3, 0.3)


@pytest.fixture
def make_cost(stage: Any) -> Callable[..., TrajectoryCost]:
    def make(
        style: tuple[float, float, float] = BALANCED,
        *,
        risky: bool = False,
        horizon_s: float | None = None,
    ) -> TrajectoryCost:
        limits = replace(stage.limits, horizon_s=horizon_s)
        reference_s = limits.least_time(4.5)
        return TrajectoryCost(
            stage.basis, stage.fields(risky=risky), limits, np.array(style), reference_s
        )

    return make


def new_starts(stage: Any, ends: Ends, count: int = 32, **how: float) -> Splines:
    splines = stage.disturbed(count, ends, **how)
    return Splines(splines.control.astype(np.float32), splines.duration)


def assert_ends(stage: Any, splines: Splines, ends: Ends) -> None:
    position, velocity, acceleration = stage.basis.states(splines)
    start = np.concatenate([x[:, 0] for x in (position, velocity, acceleration)], -1)
    goal = np.concatenate([x[:, -1] for x in (position, velocity)], -1)
    np.testing.assert_allclose(start, np.broadcast_to(ends.x_curr, start.shape), atol=3e-4)
    np.testing.assert_allclose(goal, np.broadcast_to(ends.x_goal, goal.shape), atol=3e-5)


@pytest.mark.parametrize("ends", ["moving", "at_rest"])
@pytest.mark.parametrize("horizon_s", [None, 5.0])
def test_descent_frees_anchors_and_keeps_the_ends_and_the_limits(
    make_cost: Callable[..., TrajectoryCost], stage: Any, ends: str, horizon_s: float | None
) -> None:
    problem, between = make_cost(horizon_s=horizon_s), getattr(stage, ends)
    start = new_starts(stage, between, duration=10.0)
    if horizon_s is not None:
        start = stage.basis.fit(
            stage.basis.own_time_states(start.control), between, np.full(32, horizon_s)
        )
    splines = descend(problem, start, between, steps=60, rate=0.3)
    verdict = verify(stage.basis.states(splines), problem.fields.clearance, stage.limits)
    assert (verdict.clearance > 0).mean() > 0.9
    assert verdict.feasible.mean() > 0.9
    assert_ends(stage, splines, between)
    if horizon_s is not None:
        np.testing.assert_allclose(splines.duration, horizon_s, rtol=1e-12)


def test_needlessly_long_durations_shorten_and_impossible_ones_lengthen(
    make_cost: Callable[..., TrajectoryCost], stage: Any
) -> None:
    """Both to the same; what is too fast has hinges in its way, and takes more steps."""
    problem, middles = make_cost(), []
    for duration, steps, sign in ((12.0, 60, -1.0), (1.5, 300, 1.0)):
        start = new_starts(stage, stage.moving, duration=duration, spread=0.15)
        splines = descend(problem, start, stage.moving, steps=steps, rate=0.3)
        gained = sign * np.log(splines.duration / start.duration)
        assert (gained > 0.25).mean() > 0.9
        assert (problem.value(splines) < problem.value(start)).all()
        middles.append(float(np.median(splines.duration)))
    assert middles[1] == pytest.approx(middles[0], rel=0.1)
    assert 1.0 < middles[0] / problem.reference_s < 1.5


def test_durations_settle_where_moving_ends_are_counted(
    make_cost: Callable[..., TrajectoryCost], stage: Any
) -> None:
    """J no longer changes along curves that meet both ends in every duration."""
    ends = Ends(np.array([1.0, 3.2, 0.8, 0.6, 0.5, -0.5]), np.array([5.5, 3.1, 0.8, -0.4]))
    problem, start = make_cost(), new_starts(stage, ends, 16, duration=8.0, spread=0.2)
    splines = descend(problem, start, ends, steps=100, rate=0.3)
    assert_ends(stage, splines, ends)
    _, gradient = problem.value_and_gradient(splines)
    ending = stage.basis.end_slopes(ends, splines.duration)
    by_ends = np.einsum("dmk,dmk->m", gradient.control, ending)
    whole = np.abs(gradient.log_duration + by_ends)
    assert np.median(whole) < 0.1 * np.median(np.abs(by_ends))


def test_descent_leaves_a_heading_where_it_was(
    make_cost: Callable[..., TrajectoryCost], stage: Any
) -> None:
    planar = new_starts(stage, stage.at_rest, 8)
    heading = np.random.default_rng(4).normal(0.0, 0.3, planar.control[:1].shape)
    turning = Splines(np.concatenate([planar.control, heading.astype(np.float32)]), planar.duration)
    ends = Ends(np.r_[1.0, 3.2, np.zeros(7)], np.r_[5.5, 3.1, np.zeros(4)])
    problem = make_cost(horizon_s=4.0)
    splines = descend(problem, turning, ends, steps=20, rate=0.3)
    np.testing.assert_array_equal(splines.control[2:], turning.control[2:])
    # All three dimensions share a product, so sums may be rounded differently.
    same = descend(problem, planar, stage.at_rest, steps=20, rate=0.3)
    np.testing.assert_allclose(splines.control[:2], same.control, atol=1e-4)


def test_what_it_is_given_stays(make_cost: Callable[..., TrajectoryCost], stage: Any) -> None:
    start = new_starts(stage, stage.moving, 4)
    control, duration = start.control.copy(), start.duration.copy()
    descend(make_cost(), start, stage.moving, steps=3, rate=0.3)
    np.testing.assert_array_equal(start.control, control)
    np.testing.assert_array_equal(start.duration, duration)


def test_a_tether_holds_a_trajectory_near_where_it_began(
    make_cost: Callable[..., TrajectoryCost], stage: Any
) -> None:
    """The tether costs the distance in the round coordinates; weight 0 is no tether."""
    problem, start = make_cost(horizon_s=5.0), new_starts(stage, stage.at_rest, 8)
    root = whitening(stage.basis)

    def moved(tether: float) -> float:
        splines = descend(problem, start, stage.at_rest, steps=60, rate=0.1, tether=tether)
        change = (splines.control - start.control)[..., stage.basis.free]
        return float(np.linalg.norm(np.linalg.solve(root, change[..., None]), axis=-2).mean())

    free, held, tight = (moved(tether) for tether in (0.0, 3.0, 300.0))
    assert tight < held < free
    assert tight < 0.5 * free


def test_each_style_is_visible(make_cost: Callable[..., TrajectoryCost], stage: Any) -> None:
    start = new_starts(stage, stage.at_rest, duration=10.0)

    def finished(style: tuple[float, float, float]) -> tuple[float, float, float]:
        problem = make_cost(style)
        splines = descend(problem, start, stage.at_rest, steps=100, rate=0.3)
        position, _, _ = stage.basis.states(splines)
        clearance = path_clearance(problem.fields.clearance, position)
        length = np.linalg.norm(np.diff(position, axis=1), axis=-1).sum(1)
        third = splines.control.transpose(1, 0, 2) @ stage.basis.jerk.T
        jerk = np.linalg.norm(third, axis=1).mean(1) / splines.duration**3
        return float(clearance.mean()), float(length.mean()), float(np.median(jerk))

    safe, efficient, smooth = (finished(s) for s in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    assert safe[0] > 1.2 * efficient[0]
    assert efficient[1] < safe[1]
    assert smooth[2] < 0.7 * min(safe[2], efficient[2])


def test_risky_ground_is_avoided(make_cost: Callable[..., TrajectoryCost], stage: Any) -> None:
    start = new_starts(stage, stage.at_rest, 16)
    plain, risky = (
        stage.basis.states(
            descend(make_cost((0.8, 0.1, 0.1), risky=r), start, stage.at_rest, steps=60, rate=0.3)
        )[0]
        for r in (False, True)
    )
    assert risky[..., 1].mean() > plain[..., 1].mean() + 0.1
