"""Layers that autocast does not round, and trajectories that stand still."""

from __future__ import annotations

from collections.abc import Callable

import torch
from flowmp_scenes import make_model, make_scene
from tiny_diffusiondrive import tiny_diffusiondrive
from tiny_wote import sensors, tiny_wote
from torch import Tensor

from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.goalflow import STATE
from anchorflow_models.layers.geometry import standing_still

Tell = Callable[[], list[Tensor]]


def drawn() -> Tell:
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


def test_flowmp() -> None:
    _check(drawn())


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


def ahead(metres: float) -> torch.Tensor:
    """[8, 3]: so far in 4 s, straight on, turned a little."""
    share = torch.arange(1, 9) / 8
    return torch.stack([metres * share, 0 * share, 0.02 * share], -1)


def test_who_stays_within_a_metre_stands_and_all_others_do_not() -> None:
    back_again = ahead(2.0)
    back_again[-1] = 0.0
    poses = torch.stack([ahead(0.9), ahead(1.1), ahead(-0.9), back_again])
    stood = standing_still(poses)
    assert [bool(each.any()) for each in stood] == [False, True, False, True]
    assert torch.equal(stood[[1, 3]], poses[[1, 3]])


@torch.no_grad()
def test_wote_stands_where_it_would_creep() -> None:
    model = tiny_wote()
    model.offset_units.zero_()
    anchors = model.anchors.clone()
    anchors[0], anchors[1] = ahead(0.6), ahead(3.0)
    model.set_anchors(anchors)
    context = model.encode(**sensors(B=1))
    scored = model.score(*(context[name] for name in model.context_for_score))
    assert not scored["trajectories"][0, 0].any()
    torch.testing.assert_close(scored["trajectories"][0, 1], anchors[1])
    torch.testing.assert_close(scored["trajectories"] - scored["offsets"], anchors[None])


@torch.no_grad()
def test_diffusiondrive_stands_where_it_would_creep() -> None:
    model = tiny_diffusiondrive()
    made = torch.stack([ahead(0.6), ahead(8.0)])[None]
    candidates = model.candidates(made, torch.zeros(1, 2, 2, 2))[0, :4].unflatten(0, (2, 2))
    assert not candidates[0].any()
    assert candidates[1].abs().amax() > 7.0


@torch.no_grad()
def test_goalflow_stands_where_it_would_creep_and_learns_from_what_it_meant() -> None:
    torch.manual_seed(0)
    config = GoalFlowConfig(goals=32, picked=7, width=32, channels=8, feature_channels=4)
    model = GoalFlow(config).eval()
    bev = torch.zeros(1, 20, 192, 128, dtype=torch.uint8)
    status = torch.tensor([[0, 1, 0, 0, 0.1, 0, 0, 0]])  # 0.4 m in 4 s, as it moves now
    context = model.encode(bev, status, torch.tensor([[4.6, 1.9]]))
    shadow = context["prior_mean"][:, 7:8]
    modulation = model.modulate(torch.tensor([0.0]), context)[:, :, 1:]
    assert not model.expected(shadow, shadow, modulation, context).any()
    model.train()
    assert model.expected(shadow, shadow, modulation, context)[0, 0, -1, 0] > 0.2
