"""A bundle's own finish, for anchors that no bundle proposed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.planners import NUM_SAMPLES
from anchorflow_service.bundle.manifest import SplineEntry
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.refine import Refiner
from anchorflow_trajectory.scene import Scene


def refiner_of(finish: SplineEntry, limits: MotionLimits, *, steps: int | None = None) -> Refiner:
    """What a manifest describes, over these limits; `steps` descents instead of its own."""
    return Refiner.of(
        limits,
        num_steps=NUM_SAMPLES,
        num_control_points=finish.num_control_points,
        degree=finish.degree,
        steps=finish.steps if steps is None else steps,
    )


def finished(
    states: NDArray[np.float32], scene: Scene, refiner: Refiner, finish: SplineEntry
) -> Proposals:
    """Sampled states [N, T, 6], finished as the bundle's own are where nothing else is asked."""
    refined = refiner.refine(
        states,
        scene.cost_fields,
        x_curr=scene.x_curr,
        x_goal=scene.x_goal,
        w_style=scene.w_style,
        spec=finish,
    )
    arrays = (refined.positions, refined.velocities, refined.accelerations)
    position, velocity, acceleration = (array.astype(np.float64) for array in arrays)
    dt = refiner.limits.horizon_s / (NUM_SAMPLES - 1)
    return Proposals(position, velocity, acceleration, dt, refined.safe)
