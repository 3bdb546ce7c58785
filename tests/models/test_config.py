"""Configurations: wrong fields of every planner, FlowMP's defaults and options."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, replace
from typing import Any

import pytest
import torch
from flowmp_scenes import make_model, make_scene, means_of
from small_configs import BACKBONE, DIFFUSIONDRIVE
from tiny_wote import AHEAD, TINY as WOTE
from torch import Tensor

from anchorflow_models import (
    L2Config,
    create_flowmp_transformer,
    create_flowmp_unet1d,
    create_l2_safety_cfm,
)
from anchorflow_models.goalflow import GoalFlowConfig
from anchorflow_models.v2x_vlm import V2XConfig

BASES: dict[str, Any] = {
    "flowmp": L2Config(),
    "goalflow": GoalFlowConfig(),
    "transfuser": BACKBONE,
    "wote": WOTE,
    "wote with the road ahead": AHEAD,
    "diffusiondrive": DIFFUSIONDRIVE,
    "v2x_vlm": V2XConfig(),
}
WRONG: dict[str, list[tuple[dict[str, Any], str]]] = {
    "flowmp": [
        ({"variant": "tiny"}, "variant: expected one of 'small', 'base', 'large', got 'tiny'"),
        ({"backbone": "mamba"}, "backbone: expected one of 'transformer', 'unet', got 'mamba'"),
        ({"dim": 4}, "dim: expected one of 2, 3, got 4"),
        ({"steps_per_token": 3}, "steps_per_token: expected one of 1, 2, 4, 8, got 3"),
        ({"map_scales": 3}, "map_scales: expected one of 1, 2, got 3"),
        ({"map_size": 60}, "map_size: expected a multiple of 8, got 60"),
        ({"map_size": 0}, "map_size: expected at least 8, got 0"),
        ({"map_channels": 0}, "map_channels: expected at least 1, got 0"),
        ({"layers": -1}, "layers: expected at least 0, got -1"),
        ({"heads": 3}, "width: expected an even multiple of heads, 3, got 128"),
        ({"backbone": "unet", "width": 20}, "width: expected a multiple of 8, got 20"),
        ({"activation": "tanh"}, "activation: expected one of 'squared_relu', 'relu', 'gelu'"),
        ({"fourier_features": 0}, "fourier_features: expected at least 1, got 0"),
        ({"fourier_scale": 0.0}, "fourier_scale: expected above 0, got 0.0"),
        ({"feature_channels": -1}, "feature_channels: expected at least 0, got -1"),
        ({"degree": 2}, "degree: expected at least 3, got 2"),
        ({"num_control_points": 5}, "num_control_points: expected at least 6, got 5"),
        ({"degree": 7, "num_control_points": 7}, "num_control_points: expected at least 8, got 7"),
        ({"num_steps": 12}, "num_steps: expected at least num_control_points, 18, got 12"),
        ({"num_steps": 64.0}, "num_steps: expected a value of type int, got 64.0"),
        ({"num_steps": True}, "num_steps: expected a value of type int, got True"),
        ({"map_attention": "yes"}, "map_attention: expected a value of type bool, got 'yes'"),
        ({"map_lookup": 1}, "map_lookup: expected a value of type bool, got 1"),
    ],
    "goalflow": [
        ({"backbone": "unet"}, "backbone: expected one of mlp, transformer, got 'unet'"),
        ({"picked": 256}, "picked: expected below goals, 256, got 256"),
        ({"sigma": 0.0}, "sigma: expected above 0"),
        ({"width": 18}, "width: expected an even multiple of heads, 4, got 18"),
        ({"heads": 7}, "width: expected an even multiple of heads, 7, got 192"),
        ({"channels": 12}, "channels: expected a multiple of 8, got 12"),
    ],
    "transfuser": [
        ({"image_height": 70}, "image_height: expected a multiple of 32, got 70"),
        ({"lidar_size": 0}, "lidar_size: expected a multiple of 32, got 0"),
        ({"lidar_range": 0.0}, "lidar_range: expected more than 0, got 0.0"),
        ({"depths": (1, 1)}, "depths: expected 4 numbers, one a stage"),
        ({"widths": (16, 30, 64, 96)}, "widths: expected multiples of fusion_heads, 4"),
        ({"fusion_layers": -1}, "fusion_layers: expected at least 0, got -1"),
    ],
    "wote": [
        ({"heads": 3}, "width: expected a multiple of heads, 3, got 16"),
        ({"kept": 13}, "kept: expected from 0 to 12, got 13"),
        ({"kept": 4, "offsets": False}, "kept: expected 0 without offsets"),
        ({"dt": 0.0}, "dt: expected more than 0, got 0.0"),
        ({"future_steps": 0}, "future_steps: expected at least 1, got 0"),
    ],
    "wote with the road ahead": [
        ({"dt": 0.4}, "dt: expected a multiple of 0.25 for encounters, got 0.4"),
        ({"footprint": ()}, "ground_sight: expected false without a footprint, got True"),
        (
            {"backbone": replace(AHEAD.backbone, lidar_before=False)},
            "encounters: expected none without",
        ),
        (
            {"footprint": (), "encounters": (), "driven": True},
            "driven: expected false without footprint or encounters, got True",
        ),
        (
            {"backbone": replace(AHEAD.backbone, lidar_size=96)},
            "backbone: expected a BEV of 8 n cells a side for ground_sight, got 12",
        ),
    ],
    "diffusiondrive": [
        ({"width": 60, "heads": 8}, "width: expected an even multiple of its 8 heads, got 60"),
        ({"x_range": (1.0, 2.0)}, "x_range: expected least below 0"),
        ({"steps": 3}, "steps: expected one of [1, 2, 4], got 3"),
        ({"keep": 801}, "keep: expected at most 800, got 801"),
        ({"value_kernel": 2}, "value_kernel: expected 1, 3 or 5, got 2"),
        ({"bezier_degree": 9}, "bezier_degree: expected 1 to 8, got 9"),
        ({"diversity": (-0.1, 0.1)}, "diversity: expected at least 0 each"),
        ({"look_heads": 5}, "width: expected an even multiple of its 5 heads, got 64"),
        ({"anchors": 0}, "anchors: expected at least 1, got 0"),
        ({"ego_motion": False}, "driven: expected false without ego_motion, got True"),
        (
            {"footprint": (), "encounters": ()},
            "driven: expected false without footprint or encounters, got True",
        ),
    ],
    "v2x_vlm": [
        ({"image_size": 200}, "image_size: expected a multiple of 32 from 32 to 800, got 200"),
        ({"image_size": 192.0}, "image_size: expected a multiple of 32 from 32 to 800, got 192.0"),
        ({"image_size": 768}, "positions: expected at least 1281, for two pictures of 768"),
        ({"pooled_columns": 4}, "pooled_columns: expected a divisor of 6 cells, got 4"),
        ({"variant": "huge"}, "variant: expected one of tiny, base, large, got 'huge'"),
        ({"vocabulary": 2}, "vocabulary: expected a whole number of 3 or more, got 2"),
        ({"max_tokens": -3}, "max_tokens: expected a whole number of 1 or more, got -3"),
        ({"positions": 1024.0}, "positions: expected a whole number of 1 or more, got 1024.0"),
        ({"waypoints": 0}, "waypoints: expected a whole number of 1 or more, got 0"),
        ({"head": -1}, "head: expected a whole number of 1 or more, got -1"),
        ({"projection": 0}, "projection: expected a whole number of 1 or more, got 0"),
        ({"dt": -1.0}, "dt: expected a number above 0, got -1.0"),
        ({"dt": float("nan")}, "dt: expected a number above 0, got nan"),
        ({"dropout": 1.5}, "dropout: expected a number from 0 to below 1, got 1.5"),
    ],
}


@pytest.mark.parametrize(
    ("planner", "fields", "message"),
    [(planner, *row) for planner, rows in WRONG.items() for row in rows],
)
def test_a_wrong_field_is_named(planner: str, fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match="expected ") as caught:
        replace(BASES[planner], **fields)
    assert str(caught.value).startswith(message)


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
    {"width": 48, "heads": 6, "activation": "gelu", "condition_width": 32, "fourier_features": 5},
    {"backbone": "unet", "width": 16, "condition_width": 32, "fourier_scale": 4.0},
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
def test_every_option_set(options: dict[str, Any]) -> None:
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
def test_training_reaches_every_weight(options: dict[str, Any]) -> None:
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
