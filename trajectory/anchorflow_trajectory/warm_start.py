"""Warm starts: a known trajectory as the states that the flow would have at its end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.resample import resampled_states
from anchorflow_trajectory.scene import Scene

FloatArray = NDArray[np.floating]


def warm_states(
    scene: Scene, trajectory: FloatArray, route: NDArray[np.intp], *, dt: float | None
) -> NDArray[np.float32]:
    """x_1 [N, T, 3D + 1] of anchors that begin on routes [N], in own time.

    Those of the route that lies nearest to the trajectory start from it, the others from their own
    route: a plan that is in use does not take away the other ways round.

    Args:
        scene: that the anchors are for.
        trajectory: [T', D], [T', 2D] or [T', 3D] p, v, a in SI; missing derivatives are a spline's.
        route: [N] the place of the route that each anchor begins on.
        dt: s between two of its samples; None: it lasts as long as the spline along its route.
            Where there is a horizon, the way that it goes is gone in that.
    """
    means = scene.route_states
    dim, steps = len(scene.x_goal) // 2, means.shape[1]
    place = resampled_states(trajectory, dim=dim, num_steps=steps, horizon_s=1.0)[:, :2]
    nearest = nearest_route(means, place)
    usual = float(scene.route_splines.duration[nearest])
    duration = usual if dt is None else dt * (len(trajectory) - 1)
    given = resampled_states(trajectory, dim=dim, num_steps=steps, horizon_s=duration)
    own_time = np.repeat(duration ** np.arange(3.0), dim)
    lasting = np.full((steps, 1), np.log(scene.motion.horizon_s or duration))
    warm = np.concatenate([given * own_time, lasting], -1)
    states = means[route]
    states[route == nearest] = warm
    return states.astype(np.float32)


def nearest_route(route_states: FloatArray, positions: FloatArray) -> int:
    """The place of the route that positions [T, D] follow most nearly, at equal own time.

    route_states: [R, T, 3D + 1]
    """
    apart = route_states[..., :2] - positions[:, :2]
    return int((apart**2).sum((1, 2)).argmin())
