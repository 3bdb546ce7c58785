"""Guidance: the gradient of the finish's cost goes back through the fit, and no step runs away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_trajectory.cost.clearance import GridField, clearance_field
from anchorflow_trajectory.cost.fields import CostFields
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.ode.guidance import REACH, Guidance
from anchorflow_trajectory.spline.basis import Ends, Splines, spline_basis

BASIS = spline_basis(32, num_control_points=12)
RANK, COUNT = 9, 5


@pytest.fixture(params=[(2, None), (3, None), (2, 4.0)], ids=["planar", "with heading", "horizon"])
def guidance(request: pytest.FixtureRequest) -> Guidance:
    """Guidance in a scene with a block between both ends; the prior's basis is arbitrary."""
    dim, horizon_s = request.param
    occupied = np.zeros((64, 64), bool)
    occupied[28:36, 28:36] = True
    field = GridField(clearance_field(occupied, 0.1, 0.2), 0.1, np.zeros(2))
    limits = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=horizon_s)
    style = np.array([0.4, 0.3, 0.3])
    cost = TrajectoryCost(BASIS, CostFields(field), limits, style, 2.9, 0.1)
    basis = 0.1 * np.random.default_rng(1).normal(size=(RANK, 32, 3 * dim + 1))
    return Guidance(cost, ends_of(dim), basis.reshape(RANK, -1), scale=1e-5)


def flow(guidance: Guidance) -> tuple[np.ndarray, np.ndarray]:
    """A field and states [N, T, 3D + 1] round the straight way between both ends, in float64."""
    rng, dim = np.random.default_rng(2), len(guidance.ends.x_goal) // 2
    rest = BASIS.rest_curves(guidance.ends, np.linspace(2.0, 5.0, COUNT))
    control = rest.control + rng.normal(0.0, 0.2, (dim, COUNT, BASIS.num_control_points))
    lasting = np.broadcast_to(np.log(rest.duration)[:, None, None], (COUNT, 32, 1))
    x_t = np.concatenate([BASIS.own_time_states(control), lasting], axis=-1)
    return 0.1 * rng.normal(size=x_t.shape), x_t


def ends_of(dim: int) -> Ends:
    """Moving at both, so that the fixed control points depend on the duration."""
    x_curr, x_goal = np.zeros(3 * dim), np.zeros(2 * dim)
    x_curr[:2], x_goal[:2], x_curr[dim], x_goal[dim] = (1.0, 3.2), (5.4, 3.1), 0.6, 0.5
    return Ends(x_curr, x_goal)


def cost_of_states(guidance: Guidance, states: np.ndarray) -> np.ndarray:
    """J [N] of the spline that the finish fits to states [N, T, 3D + 1]."""
    duration = guidance.cost.limits.durations(states)
    fitted = BASIS.fit(states[..., :-1], guidance.ends, duration)
    # The same in float64, so that finite differences resolve it.
    control = BASIS.end_points(guidance.ends, duration).astype(np.float64)
    control[..., BASIS.free] = BASIS.fit_free(states[..., :-1] - BASIS.own_time_states(control))
    np.testing.assert_allclose(control, fitted.control, atol=2e-5)
    return guidance.cost.value(Splines(control, duration))


def test_the_correction_is_the_gradient_through_the_fit(guidance: Guidance) -> None:
    """Along a row b of the prior's basis, J(x̂_1) rises by b'∇J: finite differences of `fit`."""
    t, (field, x_t) = 0.3, flow(guidance)
    guided = field.copy()
    guidance.correct(guided, x_t, t, stride=0.1)
    x_1 = x_t + (1 - t) * field
    h = 1e-3  # m: `fit` answers in float32
    basis = guidance.prior_basis.reshape(RANK, *x_t.shape[1:])
    rises = [
        (cost_of_states(guidance, x_1 + h * b) - cost_of_states(guidance, x_1 - h * b)) / (2 * h)
        for b in basis
    ]
    weight = guidance.scale * (1 - t) / (t**2 + (1 - t) ** 2)
    expected = -weight * np.einsum("rn,rts->nts", rises, basis)
    size = np.abs(expected).max()
    np.testing.assert_allclose(guided - field, expected, atol=5e-3 * size, rtol=0)


def test_log_duration_is_left_alone_where_there_is_a_horizon(guidance: Guidance) -> None:
    """Only the prior's rows move: a prior that moves nothing else shows it."""
    field, x_t = flow(guidance)
    basis = np.zeros((1, *x_t.shape[1:]))
    basis[..., -1] = 0.1
    guided = field.copy()
    alone = replace(guidance, prior_basis=basis.reshape(1, -1))
    alone.correct(guided, x_t, 0.3, stride=0.1)
    moved = np.abs(guided - field).max((0, 1))
    assert not moved[:-1].any()
    assert (moved[-1] > 0) == (guidance.cost.limits.horizon_s is None)


@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_a_step_moves_an_anchor_by_no_more_than_its_reach(guidance: Guidance, scale: float) -> None:
    """J rises by hundreds a metre here: without a bound a step would end far off the map."""
    stride, (field, x_t) = 0.5, flow(guidance)
    guided = field.copy()
    replace(guidance, scale=scale).correct(guided, x_t, 0.0, stride=stride)
    moved = stride * (guided - field).reshape(COUNT, -1)
    noise = moved @ np.linalg.pinv(guidance.prior_basis)
    np.testing.assert_allclose(np.linalg.norm(noise, axis=1), REACH, rtol=1e-4)


def test_at_the_end_of_the_flow_nothing_is_corrected(guidance: Guidance) -> None:
    field, x_t = flow(guidance)
    guided = field.copy()
    guidance.correct(guided, x_t, 1.0, stride=0.1)
    np.testing.assert_array_equal(guided, field)


def test_one_anchor_never_touches_another(guidance: Guidance) -> None:
    field, x_t = flow(guidance)
    together, alone = field.copy(), field[2:3].copy()
    guidance.correct(together, x_t, 0.5, stride=0.1)
    guidance.correct(alone, x_t[2:3], 0.5, stride=0.1)
    np.testing.assert_allclose(together[2:3], alone, rtol=0, atol=1e-6)
