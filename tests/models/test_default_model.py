"""The default planner stays what checkpoints hold; a change here makes all of them useless."""

from __future__ import annotations

import hashlib
from dataclasses import asdict

from anchorflow_models import L2Config, create_l2_safety_cfm

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
