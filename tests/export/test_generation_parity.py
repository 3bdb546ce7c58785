"""A checkpoint in torch and its bundle in the engine answer the same request with one answer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_models import L2Config, create_l2_safety_cfm
from anchorflow_models.generation import GeneratorConfig, TrajectoryGenerator, WarmStart
from anchorflow_service.local import LocalClient

CONFIG = L2Config(map_size=16, num_steps=24, num_control_points=12)
X_CURR, X_GOAL = [-1.5, 0.1, 0.4, 0.0, 0.0, 0.0], [1.5, -0.3, 0.0, 0.0]


def test_generator_and_engine_agree_from_a_seed(
    description: BundleDescription, adapted: Any, tmp_path: Path
) -> None:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = create_l2_safety_cfm(CONFIG).eval()
        for parameter in model.parameters():
            if not parameter.any():
                nn.init.normal_(parameter, std=0.02)
    adapter = adapted(model, T=CONFIG.num_steps, H=16, W=16)
    export_bundle(adapter, description, out=tmp_path / "bundle")
    client = LocalClient.of(tmp_path / "bundle", threads=1)

    occupancy = np.zeros((1, 48, 48), np.float32)
    occupancy[0, 28:34, 20:26] = 1.0
    plan = np.linspace([-1.5, 0.1], [1.5, -0.3], 30)
    request: dict[str, Any] = {
        "cost_map": {"data": occupancy, "resolution": 0.1},
        "x_curr": X_CURR,
        "x_goal": X_GOAL,
        "num_samples": 6,
        "seed": 11,
        "sampler": {"method": "heun", "schedule": {"uniform": 3}},
        "refine": {"project": False, "safety_margin": 0.1},
    }
    config = GeneratorConfig(method="heun", steps=3, num_samples=6, project=False)
    generator = TrajectoryGenerator(model, config)
    for warm in (None, {"trajectory": plan, "tau": 0.7}):
        served = client.plan(**request, warm_start=warm)
        warm_start = None if warm is None else WarmStart(**warm)
        drawn = generator.generate(occupancy, X_CURR, X_GOAL, seed=11, warm_start=warm_start)
        for name in ("trajectories", "velocities", "accelerations", "scores", "clearance"):
            one, other = getattr(drawn, name), getattr(served, name)
            np.testing.assert_allclose(one, other, rtol=2e-3, atol=2e-3, err_msg=name)
        np.testing.assert_array_equal(drawn.safe, served.safe)
