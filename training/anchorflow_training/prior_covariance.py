"""The covariance of the prior: how the dataset's trajectories spread in their scenes' frames."""

from __future__ import annotations

import numpy as np
import torch

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.frame import Frame
from anchorflow_training.dataset import SceneDataset, own_time_states
from anchorflow_training.reflection import reflection
from anchorflow_trajectory.spline import spline_basis


def prior_covariance(
    dataset: SceneDataset, config: L2Config, *, scenes: int = 4000, mirrored: bool = True
) -> np.ndarray:
    """Covariance [R, R] of what trajectories begin with, or differ by from their route's spline.

    Control points in (D, F) order and shares of `Frame.spread`, then log duration. A trajectory
    counts as much as in the loss.

    mirrored: count every scene's reflection too, as in training, so nothing leans to one side
    """
    arrays = dataset.arrays
    quality = np.ones(arrays["states"].shape[:2])
    if dataset.mean_quality is not None:
        quality = arrays["quality"]
    counted = np.flatnonzero(quality.any(1))
    picked = counted[np.linspace(0, len(counted) - 1, min(scenes, len(counted))).astype(int)]
    dataset.check_finite(picked)
    flat = np.concatenate([_residuals(dataset, config, scene) for scene in picked])
    share = quality[picked].reshape(-1)
    # A scene with a horizon says nothing of how durations spread where they are open.
    is_open = np.repeat(arrays["limits"][picked, 3] <= 0, arrays["states"].shape[1])
    open_share = share[is_open].sum() / share.sum()
    if open_share > 0:
        flat[:, -1] /= np.sqrt(open_share)
    if mirrored:
        signs = np.repeat(reflection(config.dim), flat.shape[1] // config.dim)
        flat = np.concatenate([flat, flat * np.append(signs, 1.0)])
        share = np.tile(share, 2)
    return (flat * share[:, None]).T.astype(np.float64) @ flat / share.sum()


def _residuals(dataset: SceneDataset, config: L2Config, scene: np.integer) -> np.ndarray:
    """[M, R] of one scene, in its axes."""
    arrays = {name: array[scene] for name, array in dataset.arrays.items()}
    ends = (torch.from_numpy(arrays[n][None, : config.dim].copy()) for n in ("x_curr", "x_goal"))
    frame = Frame.between(*ends)
    if "starts" in arrays:
        points = arrays["starts"][:, :-1].reshape(len(arrays["starts"]), config.dim, -1)
        longer = arrays["starts"][:, -1:]
    else:
        basis = spline_basis(
            config.num_steps, num_control_points=config.num_control_points, degree=config.degree
        )
        states = own_time_states(arrays["states"], arrays["durations"])
        residual = states - arrays["route_states"][arrays["route"]]
        points = basis.fit_free(residual[..., :-1]).swapaxes(0, 1)
        longer = residual[:, 0, -1:]
    turned = np.einsum("mdf,de->mef", points, frame.rotation[0].numpy())
    shares = turned.reshape(len(points), -1) / frame.spread.item()
    return np.concatenate([shares, longer], -1)
