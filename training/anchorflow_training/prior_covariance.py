"""The covariance of the prior: how the dataset's trajectories spread in their scenes' frames."""

from __future__ import annotations

import numpy as np
import torch

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.frame import Frame
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.reflection import reflection
from anchorflow_trajectory.spline import spline_basis


def prior_covariance(
    dataset: SceneDataset, config: L2Config, *, scenes: int = 4000, mirrored: bool = True
) -> np.ndarray:
    """Covariance [R, R] of the residual control points, in (D, F) order and window half sizes.

    A trajectory counts as much as in the loss.

    mirrored: count every scene's reflection too, as in training, so nothing leans to one side
    """
    basis = spline_basis(
        config.num_steps,
        config.horizon_s,
        num_control_points=config.num_control_points,
        degree=config.degree,
    )
    quality = np.ones(dataset.arrays["states"].shape[:2])
    if dataset.mean_quality is not None:
        quality = dataset.arrays["quality"]
    counted = np.flatnonzero(quality.any(1))
    picked = counted[np.linspace(0, len(counted) - 1, min(scenes, len(counted))).astype(int)]
    dataset.check_finite(picked)
    rows = []
    for scene in picked:
        x_curr, x_goal = dataset.arrays["x_curr"][scene], dataset.arrays["x_goal"][scene]
        control = basis.fit(dataset.arrays["states"][scene], x_curr, x_goal)
        residual = control - basis.rest_curve(x_curr, x_goal)[:, None]
        ends = (torch.from_numpy(x[None, : config.dim].copy()) for x in (x_curr, x_goal))
        frame = Frame.between(*ends)
        turned = np.einsum("dmf,de->mef", residual[..., basis.free], frame.rotation[0].numpy())
        rows.append(turned / frame.half_size.item())
    points, share = np.concatenate(rows), quality[picked].reshape(-1)
    if mirrored:
        points = np.concatenate([points, points * reflection(config.dim)[:, None]])
        share = np.tile(share, 2)
    flat = points.reshape(len(points), -1)
    return (flat * share[:, None]).T.astype(np.float64) @ flat / share.sum()
