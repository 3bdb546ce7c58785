"""Guidance: the gradient of the finish's cost goes back through the fit, and no step runs away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_trajectory.clearance import GridField, clearance_field
from anchorflow_trajectory.cost import CostWeights, MotionLimits, TrajectoryCost
from anchorflow_trajectory.cost_fields import CostFields
from anchorflow_trajectory.guidance import REACH, Guidance
from anchorflow_trajectory.spline import spline_basis

BASIS = spline_basis(32, 8.0, num_control_points=12)
LIMITS = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=8.0)
RANK, COUNT = 9, 5


@pytest.fixture(params=[2, 3], ids=["planar", "with heading"])
def guidance(request: pytest.FixtureRequest) -> Guidance:
    """In a scene with a block between both ends; the prior's basis is any matrix."""
    dim = request.param
    occupied = np.zeros((64, 64), bool)
    occupied[28:36, 28:36] = True
    field = GridField(clearance_field(occupied, 0.1, 0.2), 0.1, np.zeros(2))
    style = np.array([0.4, 0.3, 0.3])
    cost = TrajectoryCost(BASIS, CostFields(field), LIMITS, style, 0.1, CostWeights())
    x_curr, x_goal = ends_of(dim)
    basis = 0.1 * np.random.default_rng(1).normal(size=(RANK, 32 * 3 * dim))
    return Guidance.of(cost, x_curr=x_curr, x_goal=x_goal, prior_basis=basis, scale=1e-5)


def flow(guidance: Guidance) -> tuple[np.ndarray, np.ndarray]:
    """A field and states [N, T, 3D] round the straight way between both ends, in float64."""
    rng, dim = np.random.default_rng(2), len(guidance.ends)
    control = guidance.cost.basis.rest_curve(*ends_of(dim))[:, None]
    control = control + rng.normal(0.0, 0.2, (dim, COUNT, BASIS.num_control_points))
    x_t = np.concatenate(BASIS.states(control), axis=-1)
    return 0.1 * rng.normal(size=x_t.shape), x_t


def ends_of(dim: int) -> tuple[np.ndarray, np.ndarray]:
    x_curr, x_goal = np.zeros(3 * dim), np.zeros(2 * dim)
    x_curr[:2], x_goal[:2], x_curr[dim] = (1.0, 3.2), (5.4, 3.1), 0.4
    return x_curr, x_goal


def cost_of_states(guidance: Guidance, states: np.ndarray) -> np.ndarray:
    """J [N] of the spline that the finish fits to states [N, T, 3D]."""
    control = guidance.cost.basis.fit(states, *ends_of(len(guidance.ends)))
    return guidance.cost.value(control.astype(np.float64))


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


def test_the_fit_is_the_finishs_own(guidance: Guidance) -> None:
    _, x_t = flow(guidance)
    dim, free = len(guidance.ends), BASIS.free
    control = np.repeat(guidance.ends[:, None], COUNT, axis=1).astype(np.float64)
    moved = x_t.reshape(COUNT, -1) @ guidance.fit
    control[..., free] += moved.reshape(COUNT, dim, -1).transpose(1, 0, 2)
    np.testing.assert_allclose(control, BASIS.fit(x_t, *ends_of(dim)), atol=2e-5)


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
