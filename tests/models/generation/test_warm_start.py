"""Warm starts: the anchors stay near a plan, the nearer the later the flow starts."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from flowmp_scenes import FREE_ROOM, PLAIN, GaussianFlow, make_model
from torch import Tensor

from anchorflow_client.contract import uniform_schedule
from anchorflow_client.errors import InvalidRequest
from anchorflow_models.generation import GeneratorConfig, TrajectoryGenerator, WarmStart
from anchorflow_trajectory.ode.methods import RK4
from anchorflow_trajectory.ode.schedule import remaining, stage_times


@pytest.fixture
def detour() -> np.ndarray:
    """A plan [50, 2] from start to goal by a wide bend."""
    s = np.linspace(0, 1, 50)
    return np.stack([-3 + 6 * s, 0.05 + 1.5 * np.sin(np.pi * s) ** 2], 1)


@pytest.mark.parametrize("method", ["rk4", "rk45"])
def test_anchors_stay_near_the_plan(detour: np.ndarray, method: str) -> None:
    model = make_model(num_steps=50, num_control_points=12)
    config = GeneratorConfig(method=method, num_samples=8, rtol=1e-3, atol=1e-3, **PLAIN)
    generator = TrajectoryGenerator(model, config)

    def distance(warm_start: WarmStart | None) -> float:
        anchors = generator.generate(*FREE_ROOM.ends, seed=0, warm_start=warm_start)
        away = anchors.trajectories - torch.from_numpy(detour).float()
        return float(away.norm(dim=-1).mean())

    near, between = (distance(WarmStart(detour, tau)) for tau in (0.98, 0.6))
    far = distance(None)
    assert near < 0.1
    assert near < between < far


def test_the_flow_starts_at_tau_from_plan_and_noise(detour: np.ndarray) -> None:
    """x_1 = m + (x_tau - m_tau) / r(tau) on the Gaussian flow, x_tau = tau plan + (1 - tau) x_0."""
    tau, flow = 0.8, GaussianFlow()
    generator = TrajectoryGenerator(flow, GeneratorConfig(num_samples=3, **PLAIN))
    cold = generator.generate(*FREE_ROOM.ends, seed=1).trajectories
    flow.asked.clear()
    warm = generator.generate(*FREE_ROOM.ends, seed=1, warm_start=WarmStart(detour, tau))
    times = stage_times(RK4, remaining(uniform_schedule(8), tau)).times
    assert flow.asked == [times.tolist()]
    times = np.linspace(0, 1, 32)
    plan = np.stack([-3 + 6 * times, 0.05 + 1.5 * np.sin(np.pi * times) ** 2], 1)
    flow.prior.set_covariance(1e-12 * np.eye(flow.prior.rank))
    mean = generator.generate(*FREE_ROOM.ends, seed=1).trajectories[0]
    x_tau = tau * torch.from_numpy(plan).float() + (1 - tau) * cold  # of this flow x_1 is x_0
    expected = mean + (x_tau - mean) / np.hypot(tau, 1 - tau)
    torch.testing.assert_close(warm.trajectories, expected, atol=5e-5, rtol=0)


def test_each_scene_may_have_its_own_plan(detour: np.ndarray) -> None:
    cost_map, x_curr, x_goal = FREE_ROOM.ends
    config = GeneratorConfig(num_samples=2, project=False)
    generator = TrajectoryGenerator(GaussianFlow(), config)
    plans = np.stack([detour, detour * (1, -1)])
    ends = cost_map, np.stack([x_curr, x_curr]), x_goal

    def batch(trajectory: np.ndarray) -> Tensor:
        warm_start = WarmStart(trajectory, 0.9)
        return generator.generate_batch(*ends, seed=0, warm_start=warm_start).trajectories

    both, shared = batch(plans), batch(detour)
    torch.testing.assert_close(both[0], shared[0])
    torch.testing.assert_close(shared[1], shared[0])
    middles = both[:, :, 16, 1].mean(-1)
    assert float(middles[0]) > 1.0
    assert float(middles[1]) < -1.0


@pytest.mark.parametrize(
    ("trajectory", "message"),
    [
        (np.zeros((5, 5)), r"\[T,2\] of positions, .* \(2, 4, 6 columns\), got 5 columns"),
        (np.zeros((1, 2)), r"shape \[T,2\] to \[T,6\], got \[1, 2\]"),
        (np.zeros((3, 5, 2)), "one plan, or 1 as there are scenes, got 3"),
        (np.full((5, 2), np.nan), "finite numbers"),
        (np.zeros(5), r"shape \[T,2\] to \[T,6\], got \[5\]"),
    ],
)
def test_what_is_no_plan_is_named(trajectory: np.ndarray, message: str) -> None:
    generator = TrajectoryGenerator(GaussianFlow(), GeneratorConfig(num_samples=2))
    with pytest.raises(InvalidRequest, match=f"expected {message}") as refusal:
        generator.generate(*FREE_ROOM.ends, warm_start=WarmStart(trajectory, 0.8))
    assert refusal.value.field == "warm_start.trajectory"


def test_tau_is_inside_the_flow(detour: np.ndarray) -> None:
    generator = TrajectoryGenerator(GaussianFlow(), GeneratorConfig(num_samples=2))
    with pytest.raises(InvalidRequest, match=r"warm_start\.tau: expected a number in \(0, 1\)"):
        generator.generate(*FREE_ROOM.ends, warm_start=WarmStart(detour, 1.0))
