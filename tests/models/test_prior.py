"""The prior: a mixture over the routes, smooth disturbances that leave both ends, true units."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from flowmp_scenes import make_model, make_scene, means_of
from torch import Tensor

from anchorflow_models import L2Config
from anchorflow_models.flowmp.frame import Frame
from anchorflow_models.flowmp.prior import LEAST_SPREAD, TrajectoryPrior
from anchorflow_trajectory.routes.splines import usual_spread
from anchorflow_trajectory.spline.basis import Ends

BATCH, COUNT = 2, 6
OPEN, FIXED = torch.zeros(BATCH), torch.full((BATCH,), 5.0)

Scene = dict[str, Tensor]


@pytest.fixture(params=[2, 3])
def dim(request: pytest.FixtureRequest) -> int:
    return request.param


@pytest.fixture
def prior(dim: int) -> TrajectoryPrior:
    """A random covariance, the same each time."""
    prior = TrajectoryPrior(L2Config(dim=dim))
    root = np.random.default_rng(0).normal(size=(prior.rank, prior.rank)) / prior.rank**0.5
    prior.set_covariance(root @ root.T)
    return prior


@pytest.fixture
def frame(dim: int) -> Frame:
    """Of two scenes, 5 m and 2.5 m from start to goal."""
    start, goal = torch.zeros(2, dim), torch.zeros(2, dim)
    goal[:, :2] = torch.tensor([[3.0, 4.0], [-2.0, 1.5]])
    return Frame.between(start, goal)


def test_noise_is_drawn_around_each_samples_own_route(dim: int) -> None:
    """And what is drawn meets what its route meets at both ends: it is a trajectory between."""
    model, scene = make_model(dim=dim), make_scene(dim)
    context = model.encode(**scene)
    mean = means_of(model, scene, COUNT)
    still = model.draw(torch.zeros(1, COUNT, model.prior.rank), mean, context)
    torch.testing.assert_close(still, mean)
    noise = torch.randn(BATCH, COUNT, model.prior.rank, generator=torch.Generator().manual_seed(0))
    x_0 = model.draw(noise, mean, context)
    residual = x_0 - mean
    assert (residual[:, :, 20:40].abs().amax((-2, -1)) > 0.05).all()
    for step, fields in ((0, 3), (-1, 2)):
        assert float(residual[:, :, step, : fields * dim].abs().max()) < 1e-5
    # One log duration for the whole of a trajectory.
    assert float(residual[..., -1].std(-1).max()) < 1e-6
    assert float(residual[..., -1].std()) > 0.01
    # The same noise around another route is the same disturbance.
    other = model.draw(noise, mean.flip(1), context) - mean.flip(1)
    torch.testing.assert_close(other, residual, atol=1e-5, rtol=1e-5)


def test_a_disturbance_is_a_trajectorys(frame: Frame, dim: int) -> None:
    """p' and p'' of every unit of noise are the derivatives of its p."""
    steps = 1025
    prior = TrajectoryPrior(L2Config(dim=dim, num_steps=steps))
    basis = prior.basis(frame, OPEN).unflatten(-1, (steps, 3 * dim + 1)).double()
    for x, slope in zip(*[basis[..., :-1].split(dim, -1)[k:] for k in (0, 1)], strict=False):
        difference = (x[:, :, 2:] - x[:, :, :-2]) * (steps - 1) / 2
        error = (difference - slope[:, :, 1:-1]).abs().amax((-3, -2))
        assert (error < 0.01 * slope.abs().amax((-3, -2))).all()


def test_there_is_no_log_duration_to_draw_where_a_horizon_is_given(
    prior: TrajectoryPrior, frame: Frame
) -> None:
    free, fixed = (prior.basis(frame, h).unflatten(-1, (64, -1)) for h in (OPEN, FIXED))
    assert free[..., -1].any()
    assert not fixed[..., -1].any()
    assert torch.equal(free[..., :-1], fixed[..., :-1])
    mixed = prior.basis(frame, torch.tensor([0.0, 5.0])).unflatten(-1, (64, -1))
    assert mixed[0, ..., -1].any()
    assert not mixed[1, ..., -1].any()


def test_the_covariance_is_the_one_that_was_set(
    prior: TrajectoryPrior, frame: Frame, dim: int
) -> None:
    """Control points are in the scene's axes and shares of its spread."""
    covariance = (prior.factor.T @ prior.factor).double()
    free = prior.free[:, :, 0].double()
    scaled = frame.spread[:, None, None].double()
    basis = prior.basis(frame, OPEN).unflatten(-1, (64, -1)).double()
    turned = basis[..., :dim] @ frame.rotation[:, None].double()
    noise = turned.permute(0, 1, 3, 2).flatten(2)  # [B, R, D T]
    by_points = torch.block_diag(*[free] * dim)  # [D F, D T]
    expected = scaled**2 * (by_points.T @ covariance[:-1, :-1] @ by_points)
    torch.testing.assert_close(noise.transpose(1, 2) @ noise, expected, atol=1e-5, rtol=1e-4)
    lasting = basis[..., 0, -1]
    torch.testing.assert_close(
        lasting.square().sum(1), covariance[-1, -1].expand(BATCH), atol=1e-6, rtol=1e-5
    )


def test_units_and_si_units_are_inverses(prior: TrajectoryPrior, frame: Frame, dim: int) -> None:
    units, si_units = prior.units(frame), prior.si_units(frame)
    eye = torch.eye(3 * dim + 1).expand(BATCH, -1, -1)
    torch.testing.assert_close(units @ si_units, eye, atol=1e-5, rtol=0)
    residual = torch.randn(BATCH, COUNT, 64, 3 * dim + 1)
    back = prior.to_si(prior.normalise(residual, units), si_units)
    torch.testing.assert_close(back, residual, atol=1e-5, rtol=1e-5)
    # Log duration has no direction and no length, so it mixes with nothing.
    for matrix in (units, si_units):
        assert not matrix[:, -1, :-1].any()
        assert not matrix[:, :-1, -1].any()
    torch.testing.assert_close(si_units[:, -1, -1], prior.spread[-1].expand(BATCH))


def test_what_is_drawn_has_unit_spread(prior: TrajectoryPrior, frame: Frame) -> None:
    noise = torch.randn(BATCH, 4000, prior.rank, generator=torch.Generator().manual_seed(0))
    drawn = (noise @ prior.basis(frame, OPEN)).unflatten(-1, (64, -1))
    spread = prior.normalise(drawn, prior.units(frame)).square().mean((1, 2)).sqrt()
    torch.testing.assert_close(spread, torch.ones_like(spread), atol=0.05, rtol=0)


def test_log_duration_that_the_data_do_not_spread_keeps_a_unit(dim: int) -> None:
    prior = TrajectoryPrior(L2Config(dim=dim))
    covariance = np.eye(prior.rank)
    covariance[-1] = covariance[:, -1] = 0.0
    prior.set_covariance(covariance)
    assert prior.spread[-1].item() == pytest.approx(LEAST_SPREAD)


def test_disturbed_states_are_those_of_the_control_points(prior: TrajectoryPrior, dim: int) -> None:
    disturbance = torch.randn(4, prior.rank)
    states = prior.disturbed(disturbance)
    points = disturbance[:, :-1].unflatten(-1, (dim, -1))
    torch.testing.assert_close(
        states[..., :dim], torch.einsum("ndf,ft->ntd", points, prior.free[..., 0])
    )
    assert torch.equal(states[..., -1], disturbance[:, -1:].expand(-1, 64))


def test_wider_noise_is_as_much_wider_in_all(prior: TrajectoryPrior, frame: Frame) -> None:
    before = prior.basis(frame, OPEN)
    prior.widen(1.5)
    torch.testing.assert_close(prior.basis(frame, OPEN), 1.5 * before)


def test_the_frames_spread_is_that_of_the_routes_disturbances() -> None:
    for way in (0.5, 4.0, 50.0):
        goal = torch.tensor([[0.6 * way, 0.8 * way]])
        frame = Frame.between(torch.zeros(1, 2), goal)
        ends = Ends(np.zeros(6), np.r_[goal[0].numpy(), 0.0, 0.0])
        assert frame.spread.item() == pytest.approx(usual_spread(ends), rel=1e-5)
