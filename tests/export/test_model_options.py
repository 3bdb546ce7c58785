"""The planner's options come through export: every graph and a whole sample equal torch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import nn

from anchorflow_export.adapter import ExportChoices
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.planners.flowmp import flowmp_adapter
from anchorflow_models import L2Config, create_l2_safety_cfm

OPTION_SETS: dict[str, dict[str, Any]] = {
    "unet": {"backbone": "unet", "num_steps": 45, "map_attention": True, "map_lookup": False},
    "transformer": {
        "num_steps": 45,
        "steps_per_token": 4,
        "map_attention": True,
        "map_scales": 2,
        "feature_channels": 0,
    },
}


@pytest.mark.parametrize("options", OPTION_SETS.values(), ids=OPTION_SETS)
def test_a_planner_with_options_exports(
    options: dict[str, Any], description: BundleDescription, tmp_path: Path
) -> None:
    config = L2Config(map_size=16, map_channels=1, layers=1, **options)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = create_l2_safety_cfm(config)
        for parameter in model.parameters():  # branches start at zero, which would prove little
            if not parameter.any():
                nn.init.normal_(parameter, std=0.02)
    adapter = flowmp_adapter(model, ExportChoices())
    differences = export_bundle(adapter, description, out=tmp_path / "bundle")
    assert {part.what.split()[0] for part in differences} == {
        "encode",
        "modulate",
        "field",
        "sample",
    }
    assert max(part.error for part in differences) <= 1e-4
