"""Configurations of FlowMP: defaults, refusals, options."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import pytest
import torch
from torch import Tensor

from anchorflow_models import (
    L2Config,
    L2SafetyCFM,
    create_flowmp_transformer,
    create_flowmp_unet1d,
    create_l2_safety_cfm,
)

WRONG = [
    ({"variant": "tiny"}, "variant: expected one of 'small', 'base', 'large', got 'tiny'"),
    ({"backbone": "mamba"}, "backbone: expected one of 'transformer', 'unet', got 'mamba'"),
    ({"dim": 4}, "dim: expected one of 2, 3, got 4"),
    ({"steps_per_token": 3}, "steps_per_token: expected one of 1, 2, 4, 8, got 3"),
    ({"map_scales": 3}, "map_scales: expected one of 1, 2, got 3"),
    ({"map_size": 60}, "map_size: expected a multiple of 8, got 60"),
    ({"map_size": 0}, "map_size: expected at least 8, got 0"),
    ({"map_channels": 0}, "map_channels: expected at least 1, got 0"),
    ({"layers": -1}, "layers: expected at least 0, got -1"),
    ({"feature_channels": -1}, "feature_channels: expected at least 0, got -1"),
    ({"degree": 2}, "degree: expected at least 3, got 2"),
    ({"num_control_points": 5}, "num_control_points: expected at least 6, got 5"),
    ({"degree": 7, "num_control_points": 7}, "num_control_points: expected at least 8, got 7"),
    ({"num_steps": 12}, "num_steps: expected at least num_control_points, 18, got 12"),
    ({"num_steps": 64.0}, "num_steps: expected a value of type int, got 64.0"),
    ({"num_steps": True}, "num_steps: expected a value of type int, got True"),
    ({"map_attention": "yes"}, "map_attention: expected a value of type bool, got 'yes'"),
    ({"map_lookup": 1}, "map_lookup: expected a value of type bool, got 1"),
]


@pytest.mark.parametrize(("fields", "message"), WRONG)
def test_a_wrong_field_is_named(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=r"expected .*, got") as caught:
        L2Config(**fields)
    assert str(caught.value) == message


@pytest.mark.parametrize("dim", [2, 3])
def test_a_state_is_three_fields_and_log_duration(dim: int) -> None:
    assert L2Config(dim=dim).state_dim == 3 * dim + 1


@pytest.mark.parametrize("create", [create_flowmp_transformer, create_flowmp_unet1d])
def test_an_unknown_variant_of_a_backbone_is_named(create: Any) -> None:
    with pytest.raises(ValueError, match=r"variant: expected one of .*, got 'tiny'"):
        create("tiny")


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


# What checkpoints keep of their configuration.
SAVED = {
    "variant": "small",
    "num_steps": 64,
    "dim": 2,
    "map_channels": 3,
    "map_size": 64,
    "feature_channels": 16,
    "steps_per_token": 8,
    "num_control_points": 18,
    "degree": 4,
}


def test_names_and_shapes_of_the_weights_are_pinned() -> None:
    state = create_l2_safety_cfm().state_dict()
    lines = "\n".join(f"{name} {tuple(v.shape)} {v.dtype}" for name, v in state.items())
    assert len(state) == 97
    assert hashlib.sha256(lines.encode()).hexdigest()[:16] == "b0b9685eb19fafcc", lines


def test_a_saved_configuration_is_today_s_default() -> None:
    config = L2Config(**SAVED)
    assert config == L2Config()
    assert SAVED.items() <= asdict(config).items()


def test_the_default_context_is_pinned() -> None:
    model = create_l2_safety_cfm()
    assert model.context_for_modulate == ("condition",)
    assert model.context_for_field == (
        "frame",
        "motion_limits",
        "units",
        "si_units",
        "features",
    )
