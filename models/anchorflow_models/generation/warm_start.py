"""Warm starts: a previous plan in place of most of the noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from anchorflow_client.contract import WarmStart
from anchorflow_client.errors import InvalidRequest
from anchorflow_models.generation.scenes import as_numpy, dealt_routes
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.warm_start import warm_states, whole_fields


def noised(x_0: Tensor, warm_start: WarmStart, scenes: Sequence[Scene]) -> Tensor:
    """x_tau = tau x_1 + (1 - tau) x_0 [B, N, T, S], where x_1 is the plan on its own route.

    The plan is the contract's [T', D], [T', 2D] or [T', 3D], of any time steps, or [B, T', ...]
    where each scene has its own.

    Raises:
        InvalidRequest: the plan or tau is not that; the message names it.
    """
    given = np.asarray(as_numpy(warm_start.trajectory))
    plans = given if given.ndim == 3 else given[None]
    if len(plans) not in (1, len(scenes)):
        raise _refused(f"expected one plan, or {len(scenes)} as there are scenes, got {len(plans)}")
    each = np.broadcast_to(plans, (len(scenes), *plans.shape[1:]))
    states = [
        warm_states(
            scene,
            _checked(plan, warm_start, len(scene.x_goal) // 2),
            dealt_routes(scene, x_0.shape[1]),
            dt=warm_start.dt,
        )
        for scene, plan in zip(scenes, each, strict=True)
    ]
    x_1 = torch.from_numpy(np.stack(states)).to(x_0)
    return warm_start.tau * x_1 + (1 - warm_start.tau) * x_0


def _checked(plan: np.ndarray, warm_start: WarmStart, dim: int) -> np.ndarray:
    fields = {"trajectory": plan, "tau": warm_start.tau, "dt": warm_start.dt}
    checked = WarmStart.from_fields(fields, dim=dim).trajectory
    columns = checked.shape[1]
    if not whole_fields(columns, dim):
        raise _refused(f"expected columns of {dim} a field, got {columns}")
    return checked


def _refused(message: str) -> InvalidRequest:
    return InvalidRequest(message, "warm_start.trajectory")
