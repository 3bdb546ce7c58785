"""Guidance: the scale means what it says, and the cost is asked where the anchor is going."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from flowmp_scenes import FREE_ROOM, ROOM, GaussianFlow, make_model
from torch import Tensor

from anchorflow_models.generation import (
    GeneratorConfig,
    Guidance,
    TrajectoryGenerator,
    encode_inputs,
    requested_scenes,
)
from anchorflow_models.generation.scenes import prior_means
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.ode.guidance import Guidance as ServedGuidance

VIA = torch.tensor([0.0, 1.5])


def miss_of_via(states: Tensor) -> Tensor:
    """[B, N] m^2: how far an anchor's middle is from a point that it should pass."""
    return (states[:, :, states.shape[2] // 2, :2] - VIA).square().sum(-1)


def drawn(generator: TrajectoryGenerator, **how: Any) -> Tensor:
    """States [1, N, T, S] in own time as the generator draws them."""
    scenes = requested_scenes(*FREE_ROOM.ends, config=generator.model.config)
    return generator.sample_states(scenes, **how)


@pytest.mark.parametrize("method", ["rk4", "rk45"])
def test_a_linear_cost_tilts_a_gaussian_as_in_closed_form(method: str) -> None:
    """N(m, Σ) exp(-scale w·x) is N(m - scale Σ w, Σ): every anchor moves by -scale Σ w."""
    flow = GaussianFlow(shift=torch.tensor([0.2, 0.0, 0.0, 0.1, 0.0, 0.0, 0.1]))
    settings = {"method": method, "steps": 16, "rtol": 1e-5, "atol": 1e-5}
    generator = TrajectoryGenerator(flow, GeneratorConfig(num_samples=3, **settings))
    weight = torch.randn(32, 7, generator=torch.Generator().manual_seed(1))
    free = drawn(generator, seed=2)
    guidance = Guidance(lambda x: (x * weight).sum((-2, -1)), 0.3)
    guided = drawn(generator, seed=2, guidance=guidance)
    scenes = requested_scenes(*FREE_ROOM.ends, config=flow.config)
    context = flow.encode(**encode_inputs(scenes, torch.device("cpu")))
    basis = context["prior_basis"][0]
    moved = -0.3 * (basis.T @ (basis @ weight.flatten())).reshape(1, 1, 32, 7)
    torch.testing.assert_close(guided - free, moved.expand(1, 3, -1, -1), atol=5e-3, rtol=5e-3)


def test_a_network_is_guided_and_its_ends_stay() -> None:
    model = make_model(num_steps=32, num_control_points=12)
    generator = TrajectoryGenerator(model, GeneratorConfig(num_samples=8))
    free = drawn(generator, seed=0)
    guided = drawn(generator, seed=0, guidance=Guidance(miss_of_via, 5.0))
    assert float(miss_of_via(guided).mean()) < 0.8 * float(miss_of_via(free).mean())
    # Not the network's doing, whose ends are free: the difference starts and ends at rest.
    ends = (guided - free)[0][:, [0, -1], :2]
    assert float(ends.abs().max()) < 0.05 * float((guided - free)[..., :2].abs().max())


def test_the_cost_is_asked_about_the_end_of_the_flow() -> None:
    asked = []

    def cost(x: Tensor) -> Tensor:
        asked.append(x.detach())
        return x.sum((-2, -1))

    x_t, field = torch.randn(2, 1, 3, 4, 7)
    basis = torch.zeros(1, 2, 28)
    guided = Guidance(cost, 1.0).guided(field, x_t, 0.25, basis)
    torch.testing.assert_close(asked[0], x_t + 0.75 * field)
    torch.testing.assert_close(guided, field)  # a prior that cannot move lets nothing be moved
    assert Guidance(cost, 1.0).guided(field, x_t, 1.0, basis) is field


class StateCost(torch.autograd.Function):
    """The `TrajectoryCost` of the splines fitted to states [N, T, S], for autograd.

    Its gradient is of central differences along each unit of the prior's noise, which is all that
    guidance needs.
    """

    @staticmethod
    def forward(ctx: Any, states: Tensor, refiner: Refiner, basis: Tensor) -> Tensor:
        cost, x, h = refiner.cost(GeneratorConfig()), states.detach().double().numpy(), 1e-3

        def value(states: np.ndarray) -> np.ndarray:
            return cost.value(refiner.fitted(states)).astype(np.float64)

        units = basis.double().numpy()
        by_unit = units.reshape(len(units), *x.shape[1:])
        rises = np.stack([(value(x + h * u) - value(x - h * u)) / (2 * h) for u in by_unit], 1)
        back = np.linalg.pinv(units)  # any gradient that rises so along each of them
        ctx.gradient = torch.from_numpy((rises @ back.T).reshape(x.shape)).float()
        return torch.from_numpy(value(x)).float()

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor, None, None]:
        return slopes[0][:, None, None] * ctx.gradient, None, None


@pytest.mark.parametrize("t", [0.0, 0.4, 0.9])
@pytest.mark.parametrize("horizon_s", [None, 6.0])
def test_the_service_guides_as_this_does(t: float, horizon_s: float | None) -> None:
    """The same cost in numpy, pulled back by hand, and here by autograd and differences."""
    flow, cpu = GaussianFlow(), torch.device("cpu")
    motion = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=horizon_s)
    (scene,) = scenes = requested_scenes(*ROOM.ends, config=flow.config, motion=motion)
    context = flow.encode(**encode_inputs(scenes, cpu))
    mean = torch.from_numpy(prior_means(scenes, 6))
    basis, refiner = context["prior_basis"], Refiner(scene, 20)

    def cost_of(states: Tensor) -> Tensor:
        return StateCost.apply(states[0], refiner, basis[0])[None]

    generator = torch.Generator().manual_seed(3)
    x_t = flow.draw(torch.randn(1, 6, flow.prior.rank, generator=generator), mean, context)
    field = 0.1 * torch.randn(1, 6, 32, 7, generator=generator)
    scale = 1e-6  # below what the bound on a served step cuts
    expected = Guidance(cost_of, scale).guided(field, x_t, t, basis) - field
    served = ServedGuidance(
        refiner.cost(GeneratorConfig()), scene.ends, basis[0].numpy(), scale=scale
    )
    guided = np.zeros((6, 32, 7), np.float32)
    x_1 = (x_t + (1 - t) * field)[0].numpy()  # so that a field of zeros leads to the same end
    served.correct(guided, x_1, t, stride=0.125)
    size = float(expected.abs().max())
    np.testing.assert_allclose(guided, expected[0].numpy(), rtol=0, atol=2e-2 * size)


def test_one_anchors_cost_does_not_move_another() -> None:
    generator = TrajectoryGenerator(GaussianFlow(), GeneratorConfig(num_samples=4))
    only_first = torch.tensor([[1.0, 0, 0, 0]])
    guidance = Guidance(lambda x: only_first * miss_of_via(x), 2.0)
    free, guided = (drawn(generator, seed=0, guidance=g) for g in (None, guidance))
    moved = (guided - free)[0].abs().amax((-2, -1))
    assert float(moved[0]) > 0.1
    assert float(moved[1:].max()) == 0.0


def test_what_is_no_cost_is_named() -> None:
    generator = TrajectoryGenerator(GaussianFlow(), GeneratorConfig(num_samples=4))
    with pytest.raises(ValueError, match=r"cost: expected \[B, N\] of the states, got \[\]"):
        generator.generate(*FREE_ROOM.ends, guidance=Guidance(Tensor.sum, 1.0))
    with pytest.raises(ValueError, match="scale: expected a number of 0 or more, got -1"):
        Guidance(miss_of_via, -1.0)
