"""The compiled loops of the finish, in float32 as the service runs them, each lane on its own.

What they compute is proven by tests/trajectory/cost, `test_descent.py` and `test_certificate.py`.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.finish.certificate import are_safe, path_clearance, verify
from anchorflow_trajectory.finish.descent import descend
from anchorflow_trajectory.spline.basis import Splines
from anchorflow_trajectory.spline.kernels import LANES

MANY = 2 * LANES + 3


@pytest.fixture
def problem(stage: Any) -> TrajectoryCost:
    """On risky ground, near its limits."""
    return TrajectoryCost(
        stage.basis, stage.fields(risky=True), stage.limits, np.array([0.4, 0.3, 0.3]), 2.9, 0.08
    )


def disturbed(stage: Any, count: int, dtype: type = np.float64, **how: float) -> Splines:
    splines = stage.disturbed(count, stage.moving, **how)
    return Splines(splines.control.astype(dtype), splines.duration)


@pytest.mark.parametrize("risky", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_cost_and_its_gradient_in_float32_are_those_in_float64(
    problem: TrajectoryCost, stage: Any, risky: bool, dim: int
) -> None:
    """Also where each has its own style, and where some lie beyond the map."""
    rng, splines = np.random.default_rng(6), disturbed(stage, MANY, spread=1.5, duration=2.0)
    control = np.concatenate([splines.control, rng.normal(size=splines.control[:1].shape)])[:dim]
    problem = replace(
        problem, fields=stage.fields(risky=risky), style=rng.dirichlet(np.ones(3), MANY)
    )
    single, wide = (
        problem.value_and_gradient(Splines(control.astype(dtype), splines.duration))
        for dtype in (np.float32, np.float64)
    )
    for found, expected in zip((single[0], *single[1]), (wide[0], *wide[1]), strict=True):
        assert (found.dtype, expected.dtype) == (np.float32, np.float64)
        np.testing.assert_allclose(found, expected, rtol=2e-5, atol=2e-5 * np.abs(expected).max())


@pytest.mark.parametrize("certified", [0.0, 0.1])
def test_splines_are_judged_as_their_states_are(
    problem: TrajectoryCost, stage: Any, certified: float
) -> None:
    start = disturbed(stage, 200, np.float32, duration=4.0)
    splines = descend(problem, start, stage.moving, steps=10, rate=0.2)
    field = stage.fields().clearance
    verdict = verify(stage.basis.states(splines), field, stage.limits, certified_margin=certified)
    safe = are_safe(splines, stage.basis, field, stage.limits, certified_margin=certified)
    for each in (verdict.free, verdict.feasible):
        assert 10 < each.sum() < 190
    np.testing.assert_array_equal(safe, verdict.safe)


def test_an_anchor_gives_the_same_bytes_alone_in_a_batch_and_beside_other_threads(
    problem: TrajectoryCost, stage: Any
) -> None:
    start = disturbed(stage, MANY, np.float32)

    def finished(chosen: slice) -> list[bytes]:
        splines = descend(problem, start[chosen], stage.moving, steps=6, rate=0.12)
        states = stage.basis.states(splines)
        fitted = stage.basis.fit(np.concatenate(states, -1), stage.moving, splines.duration)
        clearance = path_clearance(problem.fields.clearance, states[0])
        arrays = (*splines.control, splines.duration, *states, *fitted.control, clearance)
        return [
            b"".join(
                np.ascontiguousarray(a[m]).tobytes() for a in (*arrays, problem.value(splines))
            )
            for m in range(len(splines))
        ]

    together = finished(slice(None))
    slices = [slice(m, m + n) for m in range(0, MANY, 7) for n in (1, 5, 40)]
    with ThreadPoolExecutor(4) as pool:
        for chosen, alone in zip(slices, pool.map(finished, slices), strict=True):
            assert alone == together[chosen]


def test_numbers_that_are_none_look_up_no_cell_beyond_the_map(
    problem: TrajectoryCost, stage: Any
) -> None:
    splines = disturbed(stage, 4, np.float32)
    splines.control[0, 1], splines.control[1, 2] = np.nan, np.inf
    cost = problem.value(splines)
    assert np.isfinite(cost).tolist() == [True, False, False, True]
    assert problem.value(splines[:1]) == cost[0]
