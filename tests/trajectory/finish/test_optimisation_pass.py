"""Attempts of the finish: what they do to durations, and an anchor's bytes in any part."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.finish.certificate import are_safe
from anchorflow_trajectory.finish.descent import descend
from anchorflow_trajectory.finish.optimisation_pass import OptimisationPass
from anchorflow_trajectory.spline.basis import Ends, Splines

MANY = 150  # more than are worked on at a time


@pytest.fixture
def cost(stage: Any) -> TrajectoryCost:
    return TrajectoryCost(
        stage.basis, stage.fields(), stage.limits, np.array([0.4, 0.3, 0.3]), 2.9, 0.08
    )


def disturbed(stage: Any, ends: Ends, duration: float, *, spread: float = 0.4) -> Splines:
    """As the service has them, in float32."""
    splines = stage.disturbed(MANY, ends, duration=duration, spread=spread)
    return Splines(splines.control.astype(np.float32), splines.duration)


def test_it_is_its_descents_where_nothing_else_is_asked(stage: Any, cost: TrajectoryCost) -> None:
    splines = disturbed(stage, stage.moving, 5.0)
    tried, safe = OptimisationPass(8, 0.2).run(cost, splines, stage.moving)
    plain = descend(cost, splines, stage.moving, steps=8, rate=0.2)
    np.testing.assert_array_equal(tried.control, plain.control)
    np.testing.assert_allclose(tried.duration, plain.duration, rtol=1e-12)
    field = cost.fields.clearance
    np.testing.assert_array_equal(safe, are_safe(tried, stage.basis, field, stage.limits))
    assert 0 < safe.sum() < MANY


def test_slowing_keeps_the_way_and_lasts_no_longer_than_the_limits_ask(
    stage: Any, cost: TrajectoryCost
) -> None:
    """A path from rest to rest is the same in any time; stretching meets the harder limit."""
    splines, ends = disturbed(stage, stage.at_rest, 2.0), stage.at_rest
    slow_down = OptimisationPass(steps=0, rate=0.1, slowed_after=True)
    slowed, _ = slow_down.run(cost, splines, ends)
    np.testing.assert_array_equal(slowed.control, splines.control)
    _, velocity, acceleration = stage.basis.states(slowed)
    speed = np.linalg.norm(velocity, axis=-1).max(1) / stage.limits.v_max
    push = np.linalg.norm(acceleration, axis=-1).max(1) / stage.limits.a_max
    longer = slowed.duration / splines.duration
    assert longer.min() >= 1.0 - 1e-12
    assert longer.max() <= 3.0 + 1e-12
    met = (longer < 2.999) & (longer > 1.001)
    assert met.sum() > 10
    np.testing.assert_allclose(np.maximum(speed, push)[met], 1.0, rtol=1e-4)
    sound = Splines(splines.control, 10 * slowed.duration)
    np.testing.assert_allclose(slow_down.run(cost, sound, ends)[0].duration, sound.duration)


def test_nothing_is_slowed_where_that_leads_farther_from_the_limits(
    stage: Any, cost: TrajectoryCost
) -> None:
    """A start that gains speed gains more of it in more time."""
    pushed = replace(stage.moving, x_curr=np.array([1.0, 3.2, 1.9, 0.0, 0.5, 0.0]))
    slow, free = disturbed(stage, stage.at_rest, 60.0, spread=0.0), stage.basis.free
    control = stage.basis.end_points(pushed, slow.duration)
    control[..., free] = slow.control[..., free]
    splines = Splines(control, slow.duration)
    top_speed = np.linalg.norm(stage.basis.states(splines)[1], axis=-1).max(1)
    assert (top_speed > 1.05 * stage.limits.v_max).sum() > 10
    kept, _ = OptimisationPass(steps=0, rate=0.1, slowed_after=True).run(cost, splines, pushed)
    np.testing.assert_allclose(kept.duration, splines.duration, rtol=1e-12)
    np.testing.assert_array_equal(kept.control[..., free], control[..., free])


def test_a_way_is_gone_in_the_share_of_its_time_that_costs_least(
    stage: Any, cost: TrajectoryCost
) -> None:
    ends, shares = stage.moving, (1.0, 0.9, 0.8, 0.7)
    slow, hurry = disturbed(stage, ends, 7.0), OptimisationPass(steps=0, rate=0.1, shares=shares)
    hurried, _ = hurry.run(cost, slow, ends)
    costs, free = [], stage.basis.free
    for share in shares:
        control = stage.basis.end_points(ends, slow.duration * share)
        control[..., free] = slow.control[..., free]
        costs.append(cost.value(Splines(control, slow.duration * share)))
    expected = np.array(shares)[np.argmin(costs, axis=0)]
    np.testing.assert_allclose(hurried.duration / slow.duration, expected)
    assert set(expected) == set(shares)
    np.testing.assert_allclose(cost.value(hurried), np.min(costs, axis=0))


def test_durations_stay_where_the_limits_have_a_horizon(stage: Any, cost: TrajectoryCost) -> None:
    splines = disturbed(stage, stage.moving, 3.0)
    lasting = replace(cost, limits=replace(cost.limits, horizon_s=3.0))
    everything = OptimisationPass(3, 0.2, slowed_before=True, slowed_after=True, shares=(1.0, 0.5))
    tried, _ = everything.run(lasting, splines, stage.moving)
    np.testing.assert_array_equal(tried.duration, splines.duration)
    assert (tried.control != splines.control).any(axis=(0, 2)).all()


@pytest.mark.parametrize("ends", ["moving", "at_rest"])
def test_each_gets_the_same_bytes_in_any_part(stage: Any, cost: TrajectoryCost, ends: str) -> None:
    given = getattr(stage, ends)
    splines = disturbed(stage, given, 2.0)
    everything = OptimisationPass(6, 0.2, slowed_before=True, slowed_after=True, shares=(1.0, 0.8))

    def in_three(work: Callable[[int, int], None], count: int) -> None:
        with ThreadPoolExecutor(3) as pool:
            list(pool.map(work, (0, 7, 80), (7, 80, count)))

    whole, whole_safe = everything.run(cost, splines, given)
    parts, parts_safe = everything.run(cost, splines, given, spread=in_three)
    assert 0 < whole_safe.sum() < MANY
    assert whole.control.tobytes() == parts.control.tobytes()
    assert whole.duration.tobytes() == parts.duration.tobytes()
    np.testing.assert_array_equal(whole_safe, parts_safe)
