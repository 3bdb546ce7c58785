"""A checkpoint in torch and its bundle in the engine answer the same request with one answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from exported_bundles import export_once

from anchorflow_models.generation import GeneratorConfig, TrajectoryGenerator, WarmStart
from anchorflow_service.local import LocalClient
from anchorflow_trajectory.motion import MotionLimits

X_CURR, X_GOAL = [-1.5, 0.1, 0.4, 0.0, 0.0, 0.0], [1.5, -0.3, 0.0, 0.0]
ARRAYS = ("trajectories", "velocities", "accelerations", "scores", "clearance", "durations")
PLAN = np.linspace([-1.5, 0.1], [1.5, -0.3], 30) + np.outer(np.sin(np.linspace(0, 3.1, 30)), [0, 1])


@pytest.fixture(scope="module")
def client() -> LocalClient:
    return LocalClient.of(export_once("flowmp").path, threads=1)


@pytest.mark.parametrize(
    ("warm", "limits", "project"),
    [
        (None, {}, False),
        (None, {"v_max": 0.6, "a_max": 0.8}, True),
        ({"trajectory": PLAN, "tau": 0.7}, {"horizon_s": 9.0}, False),
        ({"trajectory": PLAN, "tau": 0.7}, {}, True),
        ({"trajectory": PLAN, "tau": 0.7, "dt": 0.25}, {"v_max": 0.6, "a_max": 0.8}, False),
    ],
    ids=["open", "slow, projected", "warm, fixed", "warm, projected", "warm by dt, slow"],
)
def test_generator_and_engine_agree_from_a_seed(
    warm: dict[str, Any] | None,
    limits: dict[str, float],
    project: bool,
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
    drawn = TrajectoryGenerator(export_once("flowmp").network, config).generate(
        occupancy,
        X_CURR,
        X_GOAL,
        motion=MotionLimits(**({"v_max": 1.5, "a_max": 2.5} | limits)),
        robot_radius=0.3,
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
