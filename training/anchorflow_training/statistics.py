"""What the dataset's trajectories look like in the scene's own frame."""

from __future__ import annotations

import numpy as np
import torch

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.frame import Frame
from anchorflow_training.dataset import SceneDataset
from anchorflow_trajectory.spline import spline_basis


def prior_covariance(
    dataset: SceneDataset, config: L2Config, *, scenes: int = 4000, mirrored: bool = True
) -> np.ndarray:
    """Covariance [R, R] of the residual control points, in (D, F) order and window half sizes.

    mirrored: count every scene's reflection too, as in training, so nothing leans to one side
    """
    basis = spline_basis(
        config.num_steps,
        config.horizon_s,
        num_control_points=config.num_control_points,
        degree=config.degree,
    )
    picked = np.linspace(0, len(dataset) - 1, min(scenes, len(dataset))).astype(int)
    rows = []
    for scene in picked:
        x_curr, x_goal = dataset.arrays["x_curr"][scene], dataset.arrays["x_goal"][scene]
        control = basis.fit(dataset.arrays["states"][scene], x_curr, x_goal)
        residual = control - basis.rest_curve(x_curr, x_goal)[:, None]
        ends = (torch.from_numpy(x[None, : config.dim].copy()) for x in (x_curr, x_goal))
        frame = Frame.between(*ends)
        turned = np.einsum("dmf,de->mef", residual[..., basis.free], frame.rotation[0].numpy())
        rows.append(turned / frame.half_size.item())
    points = np.concatenate(rows)
    if mirrored:
        reflected = points * np.array([1.0, -1.0, -1.0])[: config.dim, None]
        points = np.concatenate([points, reflected])
    flat = points.reshape(len(points), -1)
    return flat.T.astype(np.float64) @ flat / len(flat)
