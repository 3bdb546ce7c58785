"""The student's cost in torch is the finish's own: of what it fits, before it descends."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import torch

from anchorflow_client.contract import RefineSpec
from anchorflow_models import L2Config
from anchorflow_models.generation.scenes import encode_inputs
from anchorflow_training.distillation.anchor_cost import AnchorCost
from anchorflow_training.distillation.pairs import reference_times
from anchorflow_training.scenes import RobotRanges, SceneError, draw_scene
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene

CONFIG = L2Config()
ROUGH = (0.1, 0.1, 0.5, 0.5, 2.0, 2.0, 0.1)  # m of p, p', p'', and of log duration


def drawn_scenes(count: int = 6, *, horizon_s: float | None = None) -> list[Scene]:
    rng = np.random.default_rng(5)
    limits = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=horizon_s)
    robots = RobotRanges(usual=0.5, fixed=0.0)
    scenes = []
    while len(scenes) < count:
        with suppress(SceneError):
            scenes.append(draw_scene(rng, cells=64, limits=limits, robots=robots))
    return scenes


def risky(scene: Scene) -> Scene:
    """The same, on ground that is hard to pass here and risky there."""
    cost_map = scene.cost_map.copy()
    height, width = cost_map.shape[1:]
    cost_map[1] = np.linspace(0.2, 1.0, width)
    cost_map[2] = np.linspace(0.0, 0.7, height)[:, None]
    return replace(scene, cost_map=cost_map, cost_penalty=8.0)


def disturbed(scenes: list[Scene], count: int = 8) -> np.ndarray:
    """[B, N, T, S] round each scene's first route: other ways and durations, and rough ones."""
    rng, basis = np.random.default_rng(1), CONFIG.basis
    first = np.stack([scene.route_states[:1] for scene in scenes])
    states = first + rng.normal(0.0, ROUGH, (len(scenes), count, *first.shape[2:]))
    for one in states:
        control = rng.normal(0.0, 0.7, (2, count, basis.num_control_points))
        one[..., :-1] += basis.own_time_states(control)
        one[..., -1:] += rng.normal(0.0, 0.3, (count, 1, 1))
    return states.astype(np.float32)


def expected(scenes: list[Scene], states: np.ndarray, margin: float) -> np.ndarray:
    spec = RefineSpec(smooth=True, project=True, guidance=0.0, safety_margin=margin)
    refiners = [Refiner(scene, 0) for scene in scenes]
    return np.stack(
        [
            refiner.cost(spec).value(refiner.fitted(one))
            for refiner, one in zip(refiners, states, strict=True)
        ]
    )


def in_torch(scenes: list[Scene], states: torch.Tensor, margin: float) -> torch.Tensor:
    reference_s = torch.tensor([scene.reference_s for scene in scenes])
    cost = AnchorCost(CONFIG, margin=margin)
    return cost(states, encode_inputs(scenes, torch.device("cpu")), reference_s)


@pytest.mark.parametrize("margin", [0.1, 0.35])
@pytest.mark.parametrize("horizon_s", [None, 9.0])
def test_it_is_the_cost_of_what_the_finish_fits(margin: float, horizon_s: float | None) -> None:
    scenes = drawn_scenes(horizon_s=horizon_s)
    scenes = [*scenes[:3], *map(risky, scenes[3:])]
    states = disturbed(scenes)
    wanted = expected(scenes, states, margin)
    assert np.ptp(np.log10(wanted)) > 1.5  # some hit obstacles, some do not
    got = in_torch(scenes, torch.from_numpy(states), margin)
    np.testing.assert_allclose(got.numpy(), wanted, rtol=1e-3)


def test_it_goes_on_where_anchors_leave_the_map() -> None:
    scenes = drawn_scenes(2)
    scenes[1] = risky(scenes[1])
    states = disturbed(scenes)
    states[..., :2] += 20.0
    got = in_torch(scenes, torch.from_numpy(states), 0.1)
    np.testing.assert_allclose(got.numpy(), expected(scenes, states, 0.1), rtol=1e-3)


def test_its_gradient_is_its_slope() -> None:
    """Along the steepest way, on both sides of where it was taken: the map's cells have kinks."""
    scenes = drawn_scenes(4)
    states = torch.from_numpy(disturbed(scenes)).requires_grad_()

    def told(at: torch.Tensor) -> torch.Tensor:
        return torch.log1p(in_torch(scenes, at, 0.1))

    (slope,) = torch.autograd.grad(told(states).sum(), states)
    assert (slope[..., -1].abs().amax(-1) > 0).all()  # durations learn too
    step = 1e-3 * slope / slope.square().sum((2, 3), keepdim=True)
    with torch.no_grad():
        gained = told(states + step) - told(states - step)
    np.testing.assert_allclose(gained.numpy(), 2e-3, rtol=0.1)


def test_at_rest_its_gradient_is_finite() -> None:
    """Both ends are at rest: the norm of a velocity has no slope there."""
    scenes = drawn_scenes(1)
    scene = replace(
        scenes[0],
        x_curr=np.append(scenes[0].x_curr[:2], np.zeros(4)),
        x_goal=np.append(scenes[0].x_goal[:2], np.zeros(2)),
    )
    states = torch.from_numpy(scene.route_states[None]).requires_grad_()
    in_torch([scene], states, 0.1).sum().backward()
    assert states.grad is not None
    assert states.grad.isfinite().all()


def test_no_scene_touches_another() -> None:
    scenes = drawn_scenes(3)
    states = torch.from_numpy(disturbed(scenes))
    whole = in_torch(scenes, states, 0.1)
    for b, scene in enumerate(scenes):
        torch.testing.assert_close(in_torch([scene], states[b : b + 1], 0.1), whole[b : b + 1])


def test_reference_times_of_a_batch_are_the_scenes() -> None:
    """The spline along the shortest route rounds its corners."""
    scenes = drawn_scenes(8)
    batch = {
        "route_states": np.stack([scene.route_states[:1] for scene in scenes]),
        "limits": np.stack([scene.limits for scene in scenes]),
    }
    wanted = [scene.reference_s for scene in scenes]
    np.testing.assert_allclose(reference_times(batch), wanted, rtol=0.05)
