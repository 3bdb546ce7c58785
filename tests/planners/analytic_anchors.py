"""Anchors with exact velocities and accelerations, for robots of each kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client import AnchorBatch
from anchorflow_client.contract import ModelId

Array = NDArray[np.float64]

FINE = 200  # steps of integration between two samples


def batch_of(*anchors: Sequence[Array], dt: float | Sequence[float], **arrays: Any) -> AnchorBatch:
    """Return the batch of anchors, each of positions, velocities and accelerations [T,D]."""
    p, v, a = (np.stack([anchor[i] for anchor in anchors]) for i in range(3))
    return AnchorBatch(
        arrays={"trajectories": p, "velocities": v, "accelerations": a, **arrays},
        dt=dt if isinstance(dt, float) else np.asarray(dt),
        seed=0,
        model=ModelId("made", "1", ""),
        timing_ms={},
    )


def straight(start: Sequence[float], *way: Sequence[float], seconds: float, steps: int) -> Any:
    """Return a motion [T,2] from rest to rest along straight legs of equal times.

    Each leg is of minimum jerk (Flash and Hogan, 1985).
    """
    corners = np.array([start, *way], np.float64)
    leg_s = seconds / (len(corners) - 1)
    times = np.linspace(0.0, seconds, steps)
    leg = np.minimum((times / leg_s).astype(int), len(corners) - 2)
    u = (times / leg_s - leg)[:, None]
    begin, by = corners[leg], corners[leg + 1] - corners[leg]
    return (
        begin + by * u**3 * (10.0 - 15.0 * u + 6.0 * u**2),
        by * 30.0 * u**2 * (1.0 - u) ** 2 / leg_s,
        by * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / leg_s**2,
    )


def wheeled(
    speed: Callable[[Array], Array],
    curvature: Callable[[Array], Array],
    *,
    dt: float,
    steps: int,
    heading: bool,
) -> tuple[Array, Array, Array]:
    """Return the motion [T,D] of a robot on wheels from (0, 0), by its speed and curvature in time.

    heading: with it, D = 3
    """
    h = dt / FINE
    times: Array = h * np.arange((steps - 1) * FINE + 1, dtype=np.float64)
    v, kappa = speed(times), curvature(times)
    w = kappa * v
    angle = np.concatenate([[0.0], np.cumsum(0.5 * h * (w[1:] + w[:-1]))])
    velocity = v[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    steps_m = 0.5 * h * (velocity[1:] + velocity[:-1])
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(steps_m, 0)])
    if heading:
        velocity = np.column_stack([velocity, w])
        place = np.column_stack([place, angle])
    acceleration = np.gradient(velocity, h, axis=0)
    return place[::FINE], velocity[::FINE], acceleration[::FINE]
