"""Warm starts: a known trajectory as the state that the flow would have near its end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import WarmStart
from anchorflow_client.errors import InvalidRequest
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.warm_start import warm_states, whole_fields

Array = NDArray[np.float32]


def renoised(warm_start: WarmStart, x_0: Array, route: NDArray[np.intp], scene: Scene) -> Array:
    """x_tau = tau x_1 + (1 - tau) x_0, [N,T,S], where x_1 is the trajectory on its own route.

    Raises:
        InvalidRequest: its columns are not whole positions, velocities and accelerations.
    """
    trajectory, dim = warm_start.trajectory, len(scene.x_goal) // 2
    columns = trajectory.shape[1]
    if not whole_fields(columns, dim):
        widths = ", ".join(str(dim * blocks) for blocks in (1, 2, 3))
        raise InvalidRequest(
            f"expected [T,{dim}] of positions, with velocities or with accelerations too "
            f"({widths} columns), got {columns} columns",
            "warm_start.trajectory",
        )
    x_1 = warm_states(scene, trajectory, route, dt=warm_start.dt)
    return np.float32(warm_start.tau) * x_1 + np.float32(1.0 - warm_start.tau) * x_0
