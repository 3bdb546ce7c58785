"""What holds for every planner, whichever options it has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from anchorflow_models import L2SafetyCFM

OPTION_SETS: list[dict[str, Any]] = [
    {},
    {"dim": 3},
    {"variant": "base", "feature_channels": 0},
    {"num_steps": 45},
    {"num_steps": 45, "steps_per_token": 4, "map_attention": True, "map_channels": 1},
    {"num_steps": 20, "steps_per_token": 1, "map_lookup": False, "dim": 3},
    {"steps_per_token": 2, "map_scales": 2, "map_attention": True, "map_lookup": False},
    {"map_scales": 2, "map_attention": True, "dim": 3},
    {"backbone": "unet"},
    {"backbone": "unet", "num_steps": 45, "dim": 3, "map_attention": True, "map_scales": 2},
    {"backbone": "unet", "map_lookup": False, "map_channels": 8},
    {"backbone": "unet", "map_lookup": False, "map_attention": True, "feature_channels": 0},
]
COUNT = 3
TOLERANCE = 1e-3  # m, of fields of some metres


def name_of(options: dict[str, Any]) -> str:
    return "-".join(f"{name}={value}" for name, value in options.items()) or "default"


@pytest.mark.parametrize("options", OPTION_SETS, ids=name_of)
def test_every_option_set(
    make_model: Callable[..., L2SafetyCFM],
    make_scene: Callable[..., dict[str, Tensor]],
    means_of: Callable[..., Tensor],
    options: dict[str, Any],
) -> None:
    model = make_model(map_size=16, **options)
    config = model.config
    scene = make_scene(config.dim, channels=config.map_channels)
    noise = torch.randn(1, COUNT, model.prior.rank, generator=torch.Generator().manual_seed(0))
    means = means_of(model, scene, COUNT)

    @torch.no_grad()
    def field(
        scene: dict[str, Tensor], noise: Tensor, times: Tensor, mean: Tensor = means
    ) -> Tensor:
        """Flow times are [1], shared by all samples, or [B, N]."""
        context = model.encode(**scene)
        modulation = model.modulate(times, context)
        one_time = modulation[:, 0] if times.ndim == 1 else modulation
        return model.field(model.draw(noise, mean, context), mean, one_time, context)

    together = field(scene, noise, torch.tensor([0.3]))
    assert together.shape == (2, COUNT, config.num_steps, config.state_dim)
    assert together.isfinite().all()
    assert together.abs().max() > 0.01

    second = {k: v[1:] for k, v in scene.items()}
    alone = field(second, noise[:, 2:], torch.tensor([0.3]), means[1:, 2:])
    torch.testing.assert_close(together[1:, 2:], alone, atol=TOLERANCE, rtol=TOLERANCE)

    torch.testing.assert_close(
        field(scene, noise, torch.full((2, COUNT), 0.3)), together, atol=TOLERANCE, rtol=TOLERANCE
    )
    times = torch.full((2, COUNT), 0.3)
    times[0, 1] = 0.9
    changed = ~torch.isclose(
        field(scene, noise, times), together, atol=TOLERANCE, rtol=TOLERANCE
    ).all(-1).all(-1)
    assert changed.tolist() == [[False, True, False], [False, False, False]]


@pytest.mark.parametrize("options", OPTION_SETS, ids=name_of)
def test_training_reaches_every_weight(
    make_model: Callable[..., L2SafetyCFM],
    make_scene: Callable[..., dict[str, Tensor]],
    means_of: Callable[..., Tensor],
    options: dict[str, Any],
) -> None:
    """No option leaves a weight without a part in the field; several GPUs would wait for it."""
    model = make_model(map_size=16, **options).train()
    scene = make_scene(model.config.dim, channels=model.config.map_channels)
    context, mean = model.encode(**scene), means_of(model, scene, COUNT)
    x_t = model.draw(torch.randn(1, COUNT, model.prior.rank), mean, context)
    modulation = model.modulate(torch.rand(2, COUNT), context)
    state = torch.randn_like(x_t)
    model.normalised_field(x_t, state, mean, modulation, context).square().sum().backward()
    idle = [
        name
        for name, weight in model.named_parameters()
        # A few squared ReLUs of an untrained layer are zero on these tokens.
        if reached_share(weight) < (0.75 if "feed_forward.2" in name else 1.0)
    ]
    assert idle == []


def reached_share(weight: Tensor) -> float:
    """Share of a layer's inputs from which a gradient comes; 0 where there is none at all."""
    if weight.grad is None:
        return 0.0
    columns = weight.grad.transpose(0, 1).flatten(1) if weight.ndim > 1 else weight.grad[None]
    return columns.any(1).float().mean().item()
