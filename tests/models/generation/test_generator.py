"""Drawing: methods, schedules, seeds, batches, on a flow that is known in closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from flowmp_scenes import FREE_ROOM, ROOM, GaussianFlow, make_model
from torch import Tensor

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE
from anchorflow_models.generation import (
    GeneratorConfig,
    TrajectoryGenerator,
    encode_inputs,
    generate_trajectory_anchors,
    requested_scenes,
)
from anchorflow_models.generation.generator import integrate_adaptive
from anchorflow_models.generation.scenes import dealt_routes, prior_means
from anchorflow_trajectory.ode.methods import RK4
from anchorflow_trajectory.ode.schedule import stage_times

SHIFT = torch.tensor([0.0, 0.5, 0.1, 0.0, 0.0, 0.2, 0.1])


# p' and p'' are so much larger than p.
UNITS = torch.tensor([1.0, 1.0, 6.0, 6.0, 36.0, 36.0, 1.0])


def draw(**settings: Any) -> Tensor:
    """States [N, T, S] as a configuration draws them from seed 3."""
    flow = GaussianFlow(shift=SHIFT)
    generator = TrajectoryGenerator(flow, GeneratorConfig(num_samples=5, **settings))
    scenes = requested_scenes(*FREE_ROOM.ends, config=flow.config)
    return generator.sample_states(scenes, seed=3)[0]


def expected() -> Tensor:
    """x_1 = x_0 + shift: the flow's own end, from the service's noise for seed 3."""
    flow = GaussianFlow(shift=SHIFT)
    scenes = requested_scenes(*FREE_ROOM.ends, config=flow.config)
    context = flow.encode(**encode_inputs(scenes, torch.device("cpu")))
    mean = torch.from_numpy(prior_means(scenes, 5))
    size = 5, context["prior_basis"].shape[1]
    noise = np.random.Generator(np.random.PCG64(3)).standard_normal(size, dtype=np.float32)
    return flow.draw(torch.from_numpy(noise)[None], mean, context)[0] + SHIFT


@pytest.mark.parametrize(
    ("settings", "tolerance"),
    [
        ({"method": "euler", "steps": 400}, 0.02),
        ({"method": "midpoint", "steps": 20}, 0.02),
        ({"method": "heun", "steps": 20}, 0.02),
        ({"method": "rk4", "steps": 8}, 1e-3),
        ({"method": "rk45", "rtol": 1e-5, "atol": 1e-5}, 5e-4),
    ],
)
def test_every_method_reaches_the_closed_form(settings: dict, tolerance: float) -> None:
    assert float(((draw(**settings) - expected()) / UNITS).abs().max()) < tolerance


@pytest.mark.parametrize(
    ("settings", "schedule"),
    [
        ({"schedule": "8step"}, EIGHT_STEP_SCHEDULE),
        ({"schedule": "uniform", "steps": 3}, (0.0, 1 / 3, 2 / 3, 1.0)),
        ({"schedule": (0.0, 0.3, 1.0)}, (0.0, 0.3, 1.0)),
    ],
)
def test_the_schedule_says_when_the_field_is_asked(
    settings: dict, schedule: tuple[float, ...]
) -> None:
    flow = GaussianFlow()
    config = GeneratorConfig(num_samples=2, **settings)
    TrajectoryGenerator(flow, config).generate(*FREE_ROOM.ends)
    assert flow.asked == [stage_times(RK4, schedule).times.tolist()]


@pytest.mark.parametrize("name", ["rtol", "atol"])
def test_a_looser_tolerance_asks_less_often(name: str) -> None:
    counts = []
    for tolerance in (1e-2, 1e-5):
        flow = GaussianFlow(shift=SHIFT)
        tolerances: Any = {"rtol": 1e-5, "atol": 1e-5, name: tolerance}
        config = GeneratorConfig(method="rk45", num_samples=4, **tolerances)
        TrajectoryGenerator(flow, config).generate(*FREE_ROOM.ends, seed=0)
        counts.append(len(flow.asked))
    assert counts[0] < counts[1]


def test_num_samples_and_seed() -> None:
    flow = GaussianFlow()
    # The projection compares anchors, so with it the first three of seven need not be the three.
    few = TrajectoryGenerator(flow, GeneratorConfig(num_samples=3, steps=2, project=False))
    many = TrajectoryGenerator(flow, GeneratorConfig(num_samples=7, steps=2, project=False))

    def drawn(generator: TrajectoryGenerator, seed: int | torch.Generator | None) -> Tensor:
        return generator.generate(*FREE_ROOM.ends, seed=seed).trajectories

    assert drawn(many, 1).shape == (7, 32, 2)
    torch.testing.assert_close(drawn(few, 1), drawn(many, 1)[:3])
    assert not torch.equal(drawn(few, 1), drawn(few, 2))
    assert not torch.equal(drawn(few, None), drawn(few, None))
    torches = [torch.Generator().manual_seed(5) for _ in range(2)]
    one, other = (drawn(few, torches[0]) for _ in range(2))
    assert torch.equal(one, drawn(few, torches[1]))
    assert not torch.equal(one, other)


def test_a_scene_is_the_same_alone_and_in_a_batch() -> None:
    """Neither what is drawn nor what is finished in one scene looks at another."""
    model = make_model(num_steps=32, num_control_points=12)
    generator = TrajectoryGenerator(model, GeneratorConfig(num_samples=3, steps=2, refine_steps=4))
    maps = np.zeros((2, 1, 64, 64), np.float32)
    maps[0, :, 30:34, 30:34] = 1.0
    x_curr = np.array([[-2.0, 0, 0.5, 0, 0, 0], [1.0, 2.0, 0, 0, 0, 0]])
    x_goal = np.array([[2.0, 0.5, 0, 0], [-1.0, -2.0, 0, 0]])
    style = np.array([[1.0, 0, 0], [0, 0, 1.0]])
    together = generator.generate_batch(maps, x_curr, x_goal, style, seed=4)
    assert together.trajectories.shape == (2, 3, 32, 2)
    assert together.safe.shape == together.scores.shape == together.clearance.shape == (2, 3)
    for b in range(2):
        alone = generator.generate(maps[b], x_curr[b], x_goal[b], style[b], seed=4)
        fields = ("trajectories", "velocities", "accelerations", "scores", "clearance")
        for name in (*fields, "durations"):
            one, other = getattr(alone, name), getattr(together.scene(b), name)
            torch.testing.assert_close(one, other, atol=2e-4, rtol=2e-4)


def test_anchors_begin_on_the_routes_in_turn() -> None:
    """A prior that spreads nothing leaves the routes themselves, and their durations."""
    flow = GaussianFlow()
    flow.prior.set_covariance(1e-12 * np.eye(flow.prior.rank))
    (scene,) = scenes = requested_scenes(*ROOM.ends, config=flow.config)
    (drawn,) = TrajectoryGenerator(flow, GeneratorConfig(num_samples=5)).sample_states(scenes)
    assert len(scene.routes) == 2  # one on either side of the block
    assert dealt_routes(scene, 5).tolist() == [0, 1, 0, 1, 0]
    expected = torch.from_numpy(scene.route_states)[[0, 1, 0, 1, 0]]
    torch.testing.assert_close(drawn, expected, atol=1e-3, rtol=1e-3)
    middles = drawn[:, 16, 1].sign()
    assert middles.tolist() in ([1, -1, 1, -1, 1], [-1, 1, -1, 1, -1])


def test_one_scene_is_no_batch() -> None:
    cost_map, x_curr, x_goal = FREE_ROOM.ends
    with pytest.raises(ValueError, match="B: expected one scene"):
        TrajectoryGenerator(GaussianFlow()).generate(cost_map, [x_curr, x_curr], x_goal)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"method": "rk5"},
            "method: expected one of euler, midpoint, heun, rk4, ab2, rk45, got 'rk5'",
        ),
        ({"schedule": "9step"}, "schedule: expected one of uniform, 8step, or flow times"),
        ({"schedule": (0.0, 0.5)}, "schedule: .* strictly rising to 1"),
        ({"schedule": (0.2, 1.0)}, "schedule: expected a first flow time of 0, got 0.2"),
        ({"steps": 0}, "steps: expected a whole number of 1 or more, got 0"),
        ({"num_samples": 2.5}, "num_samples: expected a whole number"),
        ({"refine_steps": 0}, "refine_steps: expected a whole number"),
        ({"rtol": 0.0}, "rtol: expected a number above 0"),
        ({"atol": -1.0}, "atol: expected a number above 0"),
        ({"safety_margin": -0.1}, "safety_margin: expected 0 m or more"),
    ],
)
def test_a_setting_out_of_range_is_named(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GeneratorConfig(**settings)


X_0 = torch.tensor([[[0.1, 0.3], [0.5, 0.7]]], dtype=torch.float64)


def slope(t: float | Tensor, x: Tensor) -> Tensor:
    """dx/dt = 3 (1 + t) x (1 - x): nonlinear, time-dependent, and solved in closed form."""
    return 3 * (1 + t) * x * (1 - x)


def exact(x_0: Tensor, start: float = 0.0) -> Tensor:
    growth = 3 * (1.5 - start - start**2 / 2)
    return 1 / (1 + (1 / x_0 - 1) * math.exp(-growth))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_the_adaptive_method_meets_its_tolerance(tolerance: float) -> None:
    evaluations = 0

    def field(t: Tensor, x: Tensor) -> Tensor:
        nonlocal evaluations
        evaluations += 1
        return slope(t, x)

    for start in (0.0, 0.6):
        got = integrate_adaptive(field, X_0, start=start, rtol=tolerance, atol=tolerance)
        assert float((got - exact(X_0, start)).abs().max()) < 5 * tolerance
    # Order 5: a thousandth of the error costs about four times the steps, not a thousand times.
    assert evaluations < 30 * 4 ** (-math.log10(tolerance) / 3)


def test_one_hard_sample_among_many_is_solved_as_if_alone() -> None:
    """Averaged over all samples its error would count for a thousandth."""

    def solved(rates: Tensor) -> Tensor:
        return integrate_adaptive(
            lambda t, x: rates * torch.cos(rates * t) * x,
            torch.ones_like(rates),
            start=0.0,
            rtol=1e-5,
            atol=1e-5,
        )

    hard = torch.full((1, 1, 1), 40.0, dtype=torch.float64)
    among_many = solved(torch.cat([hard, torch.zeros(1, 999, 1, dtype=torch.float64)], 1))
    torch.testing.assert_close(among_many[:, :1], solved(hard), rtol=1e-12, atol=0)


def test_a_tolerance_finer_than_the_numbers_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rtol: expected at least 1\.2e-06 for torch\.float32"):
        integrate_adaptive(slope, X_0.float(), start=0.0, rtol=1e-7, atol=1e-7)


MAPS = np.zeros((2, 3, 48, 48), np.float32)
MAPS[:, 1] = 1.0


def ends(dim: int) -> tuple[np.ndarray, np.ndarray]:
    x_curr, x_goal = np.zeros((2, 3 * dim)), np.zeros((2, 2 * dim))
    x_curr[:, 0], x_goal[:, 0] = (-1.5, 1.5), (1.5, -1.0)
    x_curr[:, 1] = x_goal[:, 1] = 0.07  # inside a cell, where rounding picks no other
    return x_curr, x_goal


@pytest.mark.parametrize("options", [{}, {"dim": 3}, {"backbone": "unet"}])
def test_flattened_scenes_and_samples_share_an_axis(options: dict) -> None:
    model = make_model(num_steps=32, num_control_points=12, **options)
    dim, style = model.config.dim, [[0.4, 0.3, 0.3], [0.1, 0.8, 0.1]]
    config = GeneratorConfig(num_samples=4, steps=2, refine_steps=3)
    asked = MAPS, *ends(dim), style
    fields = generate_trajectory_anchors(model, *asked, 4, config=config, seed=1)
    anchors = TrajectoryGenerator(model, config).generate_batch(*asked, seed=1)
    states = anchors.trajectories, anchors.velocities, anchors.accelerations
    for field, expected in zip(fields, states, strict=True):
        assert torch.equal(field, expected.reshape(8, 32, dim))


def test_options_reach_the_generator() -> None:
    """The same scene 10 m further east, told by its origin."""
    model = make_model(num_steps=32, num_control_points=12)

    def planned(east: float, **options: Any) -> Tensor:
        x_curr, x_goal = (each + np.eye(1, each.shape[1]) * east for each in ends(2))
        config = GeneratorConfig(steps=2, project=False)
        asked: dict[str, Any] = {"config": config, "seed": 1, "resolution": 0.2, **options}
        return generate_trajectory_anchors(model, MAPS, x_curr, x_goal, None, 4, **asked)[0]

    here, there = planned(0.0), planned(10.0, origin=[5.2, -4.8])
    torch.testing.assert_close(there, here + torch.tensor([10.0, 0.0]), atol=1e-2, rtol=0)
