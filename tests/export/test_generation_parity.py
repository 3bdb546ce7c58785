"""A checkpoint in torch and its bundle in the engine answer the same request with one answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from anchorflow_export.adapter import ExportChoices
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.planners.flowmp import flowmp_adapter
from anchorflow_models import L2Config, L2SafetyCFM, create_l2_safety_cfm
from anchorflow_models.generation import GeneratorConfig, TrajectoryGenerator, WarmStart
from anchorflow_service.local import LocalClient
from anchorflow_trajectory.motion import MotionLimits

CONFIG = L2Config(map_size=16, num_steps=24, num_control_points=12, layers=2)
X_CURR, X_GOAL = [-1.5, 0.1, 0.4, 0.0, 0.0, 0.0], [1.5, -0.3, 0.0, 0.0]
ARRAYS = ("trajectories", "velocities", "accelerations", "scores", "clearance", "durations")
RANGES = {"v_max": (0.2, 4.0), "a_max": (0.3, 6.0), "horizon_s": (1.0, 60.0)}
STEPS = GeneratorConfig().refine_steps
PLAN = np.linspace([-1.5, 0.1], [1.5, -0.3], 30) + np.outer(np.sin(np.linspace(0, 3.1, 30)), [0, 1])


@pytest.fixture(scope="module")
def model() -> L2SafetyCFM:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        made = create_l2_safety_cfm(CONFIG).eval()
        for parameter in made.parameters():
            if not parameter.any():
                nn.init.normal_(parameter, std=0.02)
    made.prior.set_covariance(0.04 * np.eye(made.prior.rank))
    return made


@pytest.fixture(scope="module")
def client(
    model: L2SafetyCFM, description: BundleDescription, tmp_path_factory: pytest.TempPathFactory
) -> LocalClient:
    out = tmp_path_factory.mktemp("parity") / "bundle"
    adapter = flowmp_adapter(model, ExportChoices(ranges=RANGES, refine_steps=STEPS))
    export_bundle(adapter, description, out=out)
    return LocalClient.of(out, threads=1)


@pytest.mark.parametrize("project", [False, True], ids=["drawn", "projected"])
@pytest.mark.parametrize(
    "limits",
    [{}, {"horizon_s": 9.0}, {"v_max": 0.6, "a_max": 0.8}],
    ids=["open", "fixed", "slow"],
)
@pytest.mark.parametrize(
    "warm",
    [None, {"trajectory": PLAN, "tau": 0.7}, {"trajectory": PLAN, "tau": 0.7, "dt": 0.25}],
    ids=["cold", "warm", "warm by dt"],
)
def test_generator_and_engine_agree_from_a_seed(
    warm: dict[str, Any] | None,
    limits: dict[str, float],
    project: bool,
    model: L2SafetyCFM,
    client: LocalClient,
) -> None:
    occupancy = np.zeros((1, 48, 48), np.float32)
    occupancy[0, 21:27, 20:26] = 1.0
    request: dict[str, Any] = {
        "cost_map": {"data": occupancy, "resolution": 0.1},
        "x_curr": X_CURR,
        "x_goal": X_GOAL,
        "num_samples": 6,
        "seed": 11,
        "sampler": {"method": "heun", "schedule": {"uniform": 3}},
        "refine": {"project": project, "safety_margin": 0.1},
        "warm_start": warm,
    }
    request.update(limits)
    served = client.plan(**request)
    config = GeneratorConfig(
        method="heun", steps=3, num_samples=6, project=project, safety_margin=0.1
    )
    drawn = TrajectoryGenerator(model, config).generate(
        occupancy,
        X_CURR,
        X_GOAL,
        motion=MotionLimits(**({"v_max": 2.0, "a_max": 3.0} | limits)),
        seed=11,
        warm_start=None if warm is None else WarmStart(**warm),
    )
    if "horizon_s" in limits:
        np.testing.assert_allclose(served.durations, 9.0)
    else:
        assert np.ptp(served.durations) > 0.1
    if not project:  # descents amplify what float32 rounds
        for name in ARRAYS:
            one, other = getattr(drawn, name), getattr(served, name)
            np.testing.assert_allclose(one, other, rtol=2e-3, atol=2e-3, err_msg=name)
    np.testing.assert_allclose(drawn.trajectories, served.trajectories, atol=0.02)
    np.testing.assert_allclose(drawn.durations, served.durations, rtol=0.01)
    np.testing.assert_array_equal(drawn.safe, served.safe)
