"""Warm starts: a previous plan in place of most of the noise."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from anchorflow_client.contract import WarmStart
from anchorflow_client.errors import InvalidRequest
from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.generation.scenes import as_numpy
from anchorflow_trajectory.resample import resampled_states, whole_fields


def noised(x_0: Tensor, warm_start: WarmStart, config: L2Config) -> Tensor:
    """x_tau = tau x_1 + (1 - tau) x_0 [B, N, T, S], where x_1 is the plan.

    The plan is the contract's [T', D], [T', 2D] or [T', 3D] over the model's horizon, of any time
    steps, or [B, T', ...] where each scene has its own.

    Raises:
        InvalidRequest: the plan or tau is not that; the message names it.
    """
    given = np.asarray(as_numpy(warm_start.trajectory))
    plans = given if given.ndim == 3 else given[None]
    if len(plans) not in (1, len(x_0)):
        raise _refused(f"expected one plan, or {len(x_0)} as there are scenes, got {len(plans)}")
    plans = np.stack([_checked(plan, warm_start.tau, config.dim) for plan in plans])
    states = resampled_states(
        plans, dim=config.dim, num_steps=config.num_steps, horizon_s=config.horizon_s
    )
    x_1 = torch.from_numpy(states).to(x_0)[:, None]
    return warm_start.tau * x_1 + (1 - warm_start.tau) * x_0


def _checked(plan: np.ndarray, tau: float, dim: int) -> np.ndarray:
    checked = WarmStart.from_fields({"trajectory": plan, "tau": tau}, dim=dim).trajectory
    columns = checked.shape[1]
    if not whole_fields(columns, dim):
        raise _refused(f"expected columns of {dim} a field, got {columns}")
    return checked


def _refused(message: str) -> InvalidRequest:
    return InvalidRequest(message, "warm_start.trajectory")
