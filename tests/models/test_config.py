"""A configuration that cannot work says which field, what was expected and what came."""

from __future__ import annotations

from typing import Any

import pytest

from anchorflow_models import L2Config, create_flowmp_transformer, create_flowmp_unet1d

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
