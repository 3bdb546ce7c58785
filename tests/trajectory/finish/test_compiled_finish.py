"""The compiled loops of the finish do what these formulas in plain numpy do, each lane on its own.

In float64 both agree to its rounding; in float32, as the service runs them, to that of float32.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.cost.trajectory_cost import CostWeights, TrajectoryCost
from anchorflow_trajectory.finish import descent
from anchorflow_trajectory.finish.certificate import CHECK_STEP, are_safe, path_clearance, verify
from anchorflow_trajectory.finish.descent import descend
from anchorflow_trajectory.spline.basis import Ends, Splines, whitening
from anchorflow_trajectory.spline.kernels import LANES

MANY = 2 * LANES + 3
Found = tuple[np.ndarray, np.ndarray, np.ndarray]


def plain_cost(problem: TrajectoryCost, splines: Splines) -> Found:
    """J [M] and its gradient [D, M, K] and [M]."""
    basis, limits, w = problem.basis, problem.limits, problem.weights
    p, first, second, third = np.split(splines.control @ basis.stacked, 4, axis=-1)
    safety, energy, smooth = w.leaning(np.atleast_2d(problem.style))[..., None]
    pace = 1.0 / splines.duration[:, None]
    by_way = 1.0 / (limits.v_max * problem.reference_s)
    slow = safety * w.slow * (pace / limits.v_max) ** 2
    short = energy * w.short * by_way**2
    jerky = smooth * w.smooth * (pace**3 / limits.jerk_scale) ** 2

    place, on_p = plain_ground(problem, p, safety * w.safety)
    fast, fast_gained, on_first = plain_excess(first, pace / limits.v_max, w.speed, w)
    hard, hard_gained, on_second = plain_excess(second, pace**2 / limits.a_max, w.acceleration, w)
    dear, dear_on_p, dear_on_first = plain_dear_ground(problem, p, first, w.dear * by_way)
    speeds, jerk = (first**2).sum(0), jerky * (third**2).sum(0)
    on_first = on_first + 2 * (slow + short) * first + dear_on_first
    slope = np.concatenate([on_p + dear_on_p, on_first, on_second, 2 * jerky * third], axis=-1)
    later = (w.time + w.quick * energy[..., 0]) * splines.duration / problem.reference_s
    cost = (place + dear + (slow + short) * speeds + fast + hard + jerk).mean(-1) + later
    gained = -2 * slow * speeds - 6 * jerk - fast_gained - 2 * hard_gained
    return cost, slope @ basis.stacked.T / p.shape[-1], later + gained.mean(-1)


def plain_ground(
    problem: TrajectoryCost, p: np.ndarray, safety: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cost [M, T] of where samples [D, M, T] lie, and its derivatives."""
    w, slope = problem.weights, np.zeros_like(p)
    clearance, along_x, along_y = problem.fields.clearance.sample_with_gradient(p[0], p[1])
    hard = np.maximum(problem.margin - clearance, 0.0)
    lack = np.maximum(1.0 - clearance / w.comfort, 0.0)
    deep = np.minimum(hard, 0.25)
    cost = w.collision * deep * (2 * hard - deep) + safety * lack**2
    rate = -2 * (w.collision * deep + safety / w.comfort * lack)
    slope[0], slope[1] = rate * along_x, rate * along_y
    return cost, slope


def plain_dear_ground(
    problem: TrajectoryCost, p: np.ndarray, first: np.ndarray, gain: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cost [M, T] of dear ground, and its derivatives by samples and by p' [D, M, T]."""
    on_p, on_first, size = np.zeros_like(p), np.zeros_like(p), np.hypot(*first[:2]) + 1e-9
    if problem.fields.surcharge is None:
        return np.zeros(size.shape), on_p, on_first
    surcharge, *slopes = problem.fields.surcharge.sample_with_gradient(p[0], p[1])
    on_p[:2] = [gain * size * slope for slope in slopes]
    on_first[:2] = gain * (1 + surcharge) * first[:2] / size
    return gain * (1 + surcharge) * size, on_p, on_first


def plain_excess(samples: np.ndarray, scale: np.ndarray, gain: float, w: CostWeights) -> Found:
    """Cost [M, T] beyond a limit, its slope by log scale, and by the samples [D, M, T]."""
    slope, size = np.zeros_like(samples), np.hypot(*samples[:2]) + 1e-9
    excess = np.maximum(size * scale - w.limit_share, 0.0)
    slope[:2] = samples[:2] * (2 * gain * excess * scale / size)
    return gain * excess**2, 2 * gain * excess * size * scale, slope


def plain_descent(
    problem: TrajectoryCost, splines: Splines, ends: Ends, steps: int, rate: float, tether: float
) -> Splines:
    """What `descend` does, where durations are free."""
    basis, free = problem.basis, problem.basis.free
    root, stretch = whitening(basis), descent.STRETCH
    control, log_duration = splines.control.copy(), np.log(splines.duration)
    held = np.delete(np.arange(basis.num_control_points), free)
    away = np.zeros_like(control[:2, :, free])
    moments = [np.zeros_like(away), np.zeros_like(away), 0 * log_duration, 0 * log_duration]
    for step in range(1, steps + 1):
        duration, decay = np.exp(log_duration), rate * 0.1 ** (step / steps)
        _, slope, by_duration = plain_cost(problem, Splines(control, duration))
        through_ends = plain_end_slopes(problem, ends, duration)
        by_duration = by_duration + np.einsum("dmk,dmk->m", slope, through_ends)
        changes = []
        for k, gradient in enumerate((slope[:2, :, free] @ root + tether * away, by_duration)):
            gradient = gradient * (stretch if k else 1.0)
            mean, spread = moments[2 * k], moments[2 * k + 1]
            mean += 0.2 * (gradient - mean)
            spread += 0.05 * (gradient**2 - spread)
            size = np.sqrt(spread / (1 - 0.95**step)) + 1e-6
            changes.append(decay / (1 - 0.8**step) * mean / size)
        away -= changes[0]
        control[:2, :, free] -= changes[0] @ root.T
        log_duration = log_duration - stretch * changes[1]
        met = np.einsum("ke,emd->dmk", basis.ends, ends.in_own_time(np.exp(log_duration)))
        control[..., held] = met[..., held]
    return Splines(control, np.exp(log_duration))


def plain_end_slopes(problem: TrajectoryCost, ends: Ends, duration: np.ndarray) -> np.ndarray:
    """The control points' derivatives by log duration [D, M, K], through the ends."""
    orders = np.array([0, 1, 2, 0, 1])[:, None, None]
    return np.einsum("ke,emd->dmk", problem.basis.ends, orders * ends.in_own_time(duration))


def plain_clearance(field: GridField, path: np.ndarray) -> float:
    """The smallest along a polyline [T, 2], followed leg by leg."""
    points = [path[-1:]]
    for start, end in pairwise(path):
        pieces = max(1, int(np.ceil(np.linalg.norm(end - start) / CHECK_STEP)))
        share = np.arange(pieces, dtype=np.float32) / np.float32(pieces)
        points.append(start + share[:, None] * (end - start))
    x, y = np.concatenate(points).T
    return float(field.sample(x, y).min())


@pytest.fixture
def problem(stage: Any) -> TrajectoryCost:
    """On risky ground, near its limits."""
    return TrajectoryCost(
        stage.basis, stage.fields(risky=True), stage.limits, np.array([0.4, 0.3, 0.3]), 2.9, 0.08
    )


def disturbed(stage: Any, count: int, dtype: type = np.float64, **how: float) -> Splines:
    splines = stage.disturbed(count, stage.moving, **how)
    return Splines(splines.control.astype(dtype), splines.duration)


@pytest.mark.parametrize(("dtype", "rtol"), [(np.float64, 1e-9), (np.float32, 2e-5)])
@pytest.mark.parametrize("risky", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_cost_and_its_gradient(
    problem: TrajectoryCost, stage: Any, dtype: type, rtol: float, risky: bool, dim: int
) -> None:
    """Also where each has its own style, and where some lie beyond the map."""
    rng, splines = np.random.default_rng(6), disturbed(stage, MANY, spread=1.5, duration=2.0)
    control = np.concatenate([splines.control, rng.normal(size=splines.control[:1].shape)])[:dim]
    problem = replace(
        problem, fields=stage.fields(risky=risky), style=rng.dirichlet(np.ones(3), MANY)
    )
    control = control.astype(dtype)
    cost, gradient = problem.value_and_gradient(Splines(control, splines.duration))
    assert cost.dtype == gradient.control.dtype == gradient.log_duration.dtype == dtype
    expected = plain_cost(problem, Splines(control.astype(np.float64), splines.duration))
    for found, plain in zip((cost, *gradient), expected, strict=True):
        np.testing.assert_allclose(found, plain, rtol=rtol, atol=rtol * np.abs(plain).max())


@pytest.mark.parametrize(("dtype", "atol"), [(np.float64, 1e-9), (np.float32, 1e-4)])
@pytest.mark.parametrize("tether", [0.0, 0.2])
def test_descents(
    problem: TrajectoryCost, stage: Any, dtype: type, atol: float, tether: float
) -> None:
    start = disturbed(stage, MANY, dtype)
    wide = Splines(start.control.astype(np.float64), start.duration)
    found = descend(problem, start, stage.moving, steps=12, rate=0.12, tether=tether)
    plain = plain_descent(problem, wide, stage.moving, 12, 0.12, tether)
    assert np.abs(plain.control - start.control).max() > 0.3
    np.testing.assert_allclose(found.control, plain.control, atol=atol, rtol=0)
    np.testing.assert_allclose(found.duration, plain.duration, atol=atol, rtol=0)


@pytest.mark.parametrize(("dtype", "atol"), [(np.float64, 1e-12), (np.float32, 1e-5)])
def test_the_clearance_of_a_path(stage: Any, dtype: type, atol: float) -> None:
    splines = disturbed(stage, 20, dtype, spread=1.5)
    position, _, _ = stage.basis.states(splines)
    field = stage.fields().clearance
    found = path_clearance(field, position)
    plain = [plain_clearance(field, path) for path in position.astype(np.float64)]
    np.testing.assert_allclose(found, plain, atol=atol, rtol=0)


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
