"""Autocast rounds what layers multiply; places, noise and trajectories in m stay as they are."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tiny_diffusiondrive import tiny_diffusiondrive
from torch import Tensor

from anchorflow_models import L2SafetyCFM
from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.goalflow import STATE

Tell = Callable[[], list[Tensor]]


def drawn(make_model: Callable[..., L2SafetyCFM], make_scene: Callable[..., dict]) -> Tell:
    model, scene = make_model(), make_scene()
    noise = torch.randn(2, 3, model.prior.rank)

    def tell() -> list[Tensor]:
        context = model.encode(**scene)
        geometry = [context[n] for n in ("prior_basis", "frame", "units", "si_units")]
        mean = torch.ones(2, 3, model.config.num_steps, context["units"].shape[-1])
        x_0 = model.draw(noise, mean, context)
        z = model.prior.normalise(x_0 - mean, context["units"])
        return [*geometry, x_0, z, model.prior.to_si(z, context["si_units"])]

    return tell


def test_flowmp(
    make_model: Callable[..., L2SafetyCFM], make_scene: Callable[..., dict[str, Tensor]]
) -> None:
    _check(drawn(make_model, make_scene))


def test_goalflow() -> None:
    model = GoalFlow(GoalFlowConfig()).eval()
    steps = model.config.num_steps
    noise, mean = torch.randn(1, 4, 3 * steps), 30 * torch.rand(1, 4, steps, STATE)
    _check(lambda: [model.draw(noise, mean)])


def test_diffusiondrive() -> None:
    variants = tiny_diffusiondrive().variants
    poses, noise = 30 * torch.rand(1, 4, 8, 3), torch.randn(1, 4, 2, 2)
    _check(lambda: [variants(poses, noise)])


def _check(tell: Tell) -> None:
    with torch.no_grad():
        exact = tell()
        with torch.autocast("cpu", torch.bfloat16):
            rounded = tell()
    for before, after in zip(exact, rounded, strict=True):
        torch.testing.assert_close(after, before, atol=0, rtol=0)
