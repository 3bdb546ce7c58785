"""One call from a model and its scenes to the anchors of all of them, one after the other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch import Tensor

from anchorflow_models.generation.config import GeneratorConfig
from anchorflow_models.generation.flow import FlowPlanner
from anchorflow_models.generation.generator import TrajectoryGenerator
from anchorflow_models.generation.scenes import Numbers


def generate_trajectory_anchors(
    model: FlowPlanner,
    cost_map: Numbers,
    x_curr: Numbers,
    x_goal: Numbers,
    w_style: Numbers | None = None,
    num_samples: int = 64,
    *,
    config: GeneratorConfig | None = None,
    **options: Any,
) -> tuple[Tensor, Tensor, Tensor]:
    """Trajectories, velocities and accelerations [B * N, T, D] in SI, scene after scene.

    cost_map: [C, H, W] in [0, 1]; x_curr: [3D] p, v, a; x_goal: [2D] p, v; w_style: [3] safety,
        energy, smooth; each with or without a B axis
    config: how they are drawn and finished, but for num_samples; `GeneratorConfig`
    options: resolution (0.1 m/cell), origin (m, [2]; the map's centre is (0, 0)), robot_radius
        (0.25 m), motion, seed, warm_start, guidance: of `TrajectoryGenerator.generate_batch`, which
        also says which anchors are safe and how long each lasts

    Raises:
        InvalidRequest: a field is not that; the message names it.
    """
    settings = replace(config or GeneratorConfig(), num_samples=num_samples)
    anchors = TrajectoryGenerator(model, settings).generate_batch(
        cost_map, x_curr, x_goal, w_style, **options
    )
    states = anchors.trajectories, anchors.velocities, anchors.accelerations
    trajectories, velocities, accelerations = (field.flatten(0, 1) for field in states)
    return trajectories, velocities, accelerations
