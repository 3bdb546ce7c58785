"""Warm starts: a known trajectory in place of most of the noise.

The states that a flow starts from are tested in `tests/trajectory/test_warm_start.py`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asked_engine import AS_SAMPLED, FINISHED, Build

from anchorflow_client.contract import AnchorRequest, resolve_for_card
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning
from anchorflow_service.local import LocalClient
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.warm_start import SLOWEST, warm_states

LASTS = 4.0
START, GOAL = np.array([-3.0, 0.1]), np.array([3.0, 0.2])


def scene_of(folder: Path, request: AnchorRequest) -> Scene:
    bundle = load_bundle(folder)
    asked = resolve_for_card(request, bundle.card)
    return CostMapConditioning(bundle.manifest).scenes(asked)[0].scene


@pytest.fixture
def scene(free_bundle: Path, small_request: Build) -> Scene:
    """Return a scene with two routes, and anchors with their own durations."""
    return scene_of(free_bundle, small_request())


def detour(steps: int, side: float = 1.0, *, lasts: float = LASTS) -> np.ndarray:
    """States [steps,6] in SI from START to GOAL round the obstacle, a cubic that splines hold."""
    s = np.linspace(0.0, 1.0, steps)[:, None]
    bend = np.array([[0.0, 4.0 * side]])
    p = START + s * (GOAL - START) + (s - s**2) * bend
    v = ((GOAL - START) + (1 - 2 * s) * bend) / lasts
    a = np.broadcast_to(-2 * bend, p.shape) / lasts**2
    return np.concatenate([p, v, a], axis=1)


def in_own_time(states: np.ndarray, duration: float) -> np.ndarray:
    return states * np.repeat(duration ** np.arange(3.0), 2)


def on(side: float, scene: Scene) -> int:
    """The place of the route that passes the obstacle on this side."""
    beside = side * scene.route_states[:, 3:5, 1].mean(1)
    return int(beside.argmax())


ROUTE = np.array([0, 1, 0, 1, 0])


@pytest.mark.parametrize(
    ("dt", "share"), [(1e-300, 1.0), (1e-6, 1.0), (0.01, 1.0), (600.0, SLOWEST)]
)
def test_what_is_too_quick_or_too_slow_is_gone_as_the_robot_can(
    scene: Scene, dt: float, share: float
) -> None:
    """The way is kept, and lasts no less than it needs at the limits."""
    got = warm_states(scene, detour(200)[:, :2], ROUTE, dt=dt)
    warm = got[on(1.0, scene) == ROUTE][0]
    length = np.linalg.norm(np.diff(warm[:, :2], axis=0), axis=1).sum()
    least = scene.motion.least_time(float(length))
    np.testing.assert_allclose(np.exp(warm[:, 6]), share * least, rtol=1e-5)
    np.testing.assert_allclose(warm[:, :6], in_own_time(detour(8), LASTS), atol=2e-3)


@pytest.mark.parametrize("way", [0.0, 1e-6, 0.03])
@pytest.mark.parametrize("columns", [2, 6])
def test_a_remainder_of_centimetres_is_answered(
    free_bundle: Path, small_request: Build, way: float, columns: int
) -> None:
    start = np.array([0.5, 2.0])
    goal = start + np.array([way, 0.0])
    rest = np.linspace(start, goal, 6)
    trajectory = np.concatenate([rest, np.zeros((6, columns - 2))], axis=1)
    batch = LocalClient.of(free_bundle, threads=1).plan_request(
        small_request(
            x_curr=[*start, 0.0, 0.0, 0.0, 0.0],
            x_goal=[*goal, 0.0, 0.0],
            warm_start={"trajectory": trajectory, "tau": 0.9, "dt": 1e-5},
            refine=FINISHED,
        )
    )
    assert batch.is_finite
    assert batch.durations.min() > 0.1
    np.testing.assert_allclose(batch.trajectories[:, -1], [goal] * 20, atol=1e-4)


def turning(steps: int) -> np.ndarray:
    """States [steps,9] with a heading that splines represent exactly too."""
    t = np.linspace(0.0, LASTS, steps)
    heading = [0.05 * t**2 + 0.3, 0.1 * t, np.full_like(t, 0.1)]
    planar = detour(steps)
    columns = [(planar[:, 2 * k : 2 * k + 2], heading[k][:, None]) for k in range(3)]
    return np.concatenate([part for pair in columns for part in pair], axis=1)


@pytest.fixture
def turning_scene(free_bundle: Path, small_request: Build) -> Scene:
    """Return a scene of a robot with a heading."""
    planar = scene_of(free_bundle, small_request())
    states = turning(2)
    return Scene(
        cost_map=planar.cost_map,
        resolution=planar.resolution,
        origin=planar.origin,
        robot_radius=planar.robot_radius,
        x_curr=states[0],
        x_goal=states[-1, :6],
        w_style=planar.w_style,
        motion=planar.motion,
        basis=planar.basis,
    )


@pytest.mark.parametrize("columns", [3, 6, 9])
def test_six_columns_are_velocities_too_where_the_card_has_a_heading(
    turning_scene: Scene, columns: int
) -> None:
    got = warm_states(turning_scene, turning(31)[:, :columns], ROUTE, dt=LASTS / 30)
    expected = turning(8) * np.repeat(LASTS ** np.arange(3.0), 3)
    warm = got[on(1.0, turning_scene) == ROUTE][0]
    np.testing.assert_allclose(warm[:, :9], expected, atol=1e-4)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_flow_goes_on_from_tau(free_bundle: Path, small_request: Build, side: float) -> None:
    """x_tau = tau x_1 + (1 - tau) x_0, and the field moves the rest: 1 - tau⁴ of the channel
    means, and 1 - tau of what a route pulls."""
    tau, scene = 0.75, scene_of(free_bundle, small_request())
    ask: dict[str, Any] = {
        "warm_start": {"trajectory": detour(8, side), "tau": tau, "dt": LASTS / 7},
        "refine": AS_SAMPLED,
    }
    batch = LocalClient.of(free_bundle, threads=1).plan_request(small_request(**ask))

    noise = np.random.Generator(np.random.PCG64(7)).standard_normal((20, 3), dtype=np.float32)
    route = np.arange(20) % 2
    mean = scene.route_states[route]
    x_1 = mean[..., :2].copy()
    x_1[route == on(side, scene)] = detour(8, side)[:, :2]
    x_0 = mean[..., :2] + 0.1 * noise[:, None, :1]
    moved = np.array([4 / 256, 1.0]) * (1 - tau**4)
    np.testing.assert_allclose(batch.trajectories, tau * x_1 + (1 - tau) * x_0 + moved, atol=1e-5)
    log_1 = np.where(route == on(side, scene), np.log(LASTS), mean[:, 0, 6])
    log_0 = mean[:, 0, 6] + 0.1 * noise[:, 2]
    np.testing.assert_allclose(batch.durations, np.exp(tau * log_1 + (1 - tau) * log_0), rtol=1e-5)
