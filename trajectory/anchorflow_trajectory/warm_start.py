"""Warm starts: a known trajectory as the states that the flow would have at its end."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.routes.splines import LEAST_WAY
from anchorflow_trajectory.scene import Scene

SLOWEST = 10.0  # times the least time of its path; a flow has seen no slower plans


def warm_states(
    scene: Scene, trajectory: FloatArray, route: NDArray[np.intp], *, dt: float | None
) -> NDArray[np.float32]:
    """Return x_1 [N, T, 3D + 1] of anchors on routes [N], in own time.

    Anchors of the route nearest to the trajectory start from it, the others from their own route:
    a plan in use does not remove the alternatives. The rest of a plan may be a few centimetres
    long or exceed the limits: it keeps its path, and the limits bound its duration.

    Args:
        scene: of the anchors.
        trajectory: [T', D], [T', 2D] or [T', 3D] p, v, a in SI; a spline adds missing derivatives.
        route: [N] index of the route of each anchor.
        dt: s between two samples; None: the duration of the spline along its route. A horizon
            overrides both.
    """
    means = scene.route_states
    dim, steps = len(scene.x_goal) // 2, means.shape[1]
    fields = trajectory.shape[1] // dim

    def in_own_time(duration: float) -> FloatArray:
        scaled = trajectory * np.repeat(duration ** np.arange(float(fields)), dim)
        return resampled_states(scaled, dim=dim, num_steps=steps, horizon_s=1.0)

    place = in_own_time(1.0)[:, :2]
    nearest = nearest_route(means, place)
    usual = float(scene.route_splines.duration[nearest])
    duration = usual if dt is None else dt * (len(trajectory) - 1)
    lasting = np.full((steps, 1), np.log(_bounded(duration, place, scene)))
    states = means[route]
    states[route == nearest] = np.concatenate([in_own_time(duration), lasting], -1)
    return states


def nearest_route(route_states: FloatArray, positions: FloatArray) -> int:
    """Return the index of the route nearest to positions [T, D] at equal own time.

    route_states: [R, T, 3D + 1]
    """
    apart = route_states[..., :2] - positions[:, :2]
    return int((apart**2).sum((1, 2)).argmin())


def _bounded(duration: float, place: FloatArray, scene: Scene) -> float:
    """Return the horizon, or the duration [s] clipped to what the path [T, 2] needs."""
    if scene.motion.horizon_s is not None:
        return scene.motion.horizon_s
    way = float(np.linalg.norm(np.diff(place, axis=0), axis=-1).sum())
    least = scene.motion.least_time(max(way, LEAST_WAY))
    return float(np.clip(duration, least, SLOWEST * least))


FIELDS = 3  # position, velocity, acceleration


def whole_fields(columns: int, dim: int) -> bool:
    """Whether that many columns are whole positions, velocities and accelerations of D = `dim`."""
    return columns % dim == 0 and 1 <= columns // dim <= FIELDS


def resampled_states(
    trajectories: FloatArray, *, dim: int, num_steps: int, horizon_s: float
) -> FloatArray:
    """[..., T', D], [..., T', 2D] or [..., T', 3D] over the horizon as states [..., T, 3D].

    Cubic splines interpolate the samples and give missing derivatives.
    """
    steps, columns = trajectories.shape[-2:]
    weights, step_s = cubic_weights(steps, num_steps), horizon_s / (steps - 1)
    missing = FIELDS - columns // dim
    derived = [
        (weights[order] / step_s**order) @ trajectories[..., -dim:]
        for order in range(1, missing + 1)
    ]
    return np.concatenate([weights[0] @ trajectories, *derived], axis=-1).astype(np.float32)


@lru_cache(maxsize=32)
def cubic_weights(steps: int, num_steps: int) -> NDArray[np.float64]:
    """[3, T, T']: value, slope and bend of the cubic spline through T' samples a unit apart, at T
    equal steps, as sums of the samples.

    The spline is one cubic over the first two pieces and one over the last two ("not a knot"; de
    Boor, *A Practical Guide to Splines*, 1978, chapter IV): the parabola through three samples, the
    line through two.
    """
    samples = np.eye(steps)
    bends = np.diff(samples, n=2, axis=0)
    known, ties = np.zeros((steps, steps)), np.zeros((steps, steps))
    known[1:-1], ties[1:-1] = 6.0 * bends, bends + 6.0 * samples[1:-1]
    ties[[0, -1]] = np.diff(samples, n=min(2, steps - 2), axis=0)[[0, -1]]
    second = np.linalg.solve(ties, known)  # at the samples

    at = np.linspace(0.0, steps - 1.0, num_steps)
    piece = np.minimum(at.astype(int), steps - 2)
    right = (at - piece)[:, None]
    left = 1.0 - right
    value = left * samples[piece] + right * samples[piece + 1]
    value += ((left**3 - left) * second[piece] + (right**3 - right) * second[piece + 1]) / 6.0
    slope = samples[piece + 1] - samples[piece]
    slope += ((3 * right**2 - 1) * second[piece + 1] - (3 * left**2 - 1) * second[piece]) / 6.0
    weights = np.stack([value, slope, left * second[piece] + right * second[piece + 1]])
    weights.setflags(write=False)
    return weights
