"""`generate_trajectory_anchors`: the generator, flattened."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from anchorflow_models import L2SafetyCFM
from anchorflow_models.generation import (
    GeneratorConfig,
    TrajectoryGenerator,
    generate_trajectory_anchors,
)

MAPS = np.zeros((2, 3, 48, 48), np.float32)
MAPS[:, 1] = 1.0
STYLE = [[0.4, 0.3, 0.3], [0.1, 0.8, 0.1]]


def ends(dim: int) -> tuple[np.ndarray, np.ndarray]:
    x_curr, x_goal = np.zeros((2, 3 * dim)), np.zeros((2, 2 * dim))
    x_curr[:, 0], x_goal[:, 0] = (-1.5, 1.5), (1.5, -1.0)
    x_curr[:, 1] = x_goal[:, 1] = 0.07  # inside a cell, where rounding picks no other
    return x_curr, x_goal


@pytest.mark.parametrize("options", [{}, {"dim": 3}, {"backbone": "unet"}])
def test_scenes_and_samples_share_an_axis(
    make_model: Callable[..., L2SafetyCFM], options: dict
) -> None:
    model = make_model(num_steps=32, num_control_points=12, **options)
    dim = model.config.dim
    config = GeneratorConfig(steps=2, refine_steps=3)
    fields = generate_trajectory_anchors(model, MAPS, *ends(dim), STYLE, 4, config=config, seed=1)
    assert [tuple(field.shape) for field in fields] == [(8, 32, dim)] * 3
    generator = TrajectoryGenerator(model, GeneratorConfig(num_samples=4, steps=2, refine_steps=3))
    anchors = generator.generate_batch(MAPS, *ends(dim), STYLE, seed=1)
    states = anchors.trajectories, anchors.velocities, anchors.accelerations
    for field, expected in zip(fields, states, strict=True):
        assert torch.equal(field, expected.reshape(8, 32, dim))


def test_options_reach_the_generator(make_model: Callable[..., L2SafetyCFM]) -> None:
    """The same scene 10 m further east, told by its origin."""
    model = make_model(num_steps=32, num_control_points=12)
    config = GeneratorConfig(steps=2, project=False)
    x_curr, x_goal = ends(2)
    here, *_ = generate_trajectory_anchors(
        model, MAPS, x_curr, x_goal, num_samples=4, config=config, seed=1, resolution=0.2
    )
    x_curr[:, 0] += 10.0
    x_goal[:, 0] += 10.0
    there, *_ = generate_trajectory_anchors(
        model,
        MAPS,
        x_curr,
        x_goal,
        None,
        4,
        config=config,
        seed=1,
        resolution=0.2,
        origin=[5.2, -4.8],
    )
    torch.testing.assert_close(there, here + torch.tensor([10.0, 0.0]), atol=1e-2, rtol=0)
