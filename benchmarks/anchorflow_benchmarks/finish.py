"""A bundle's own finish, for anchors that no bundle proposed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.planners import NUM_SAMPLES
from anchorflow_service.bundle.manifest import SplineEntry
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.refine import Refiner
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline import SplineBasis, Splines, spline_basis


def basis_of(finish: SplineEntry) -> SplineBasis:
    """Of the splines that a manifest describes."""
    return spline_basis(
        NUM_SAMPLES, num_control_points=finish.num_control_points, degree=finish.degree
    )


def with_descents(finish: SplineEntry, descents: int) -> SplineEntry:
    """The same finish with so many descents; without any it smooths alone."""
    changes = {"steps": descents} if descents else {"smooth": True, "project": False}
    return finish.model_copy(update=changes)


def unfinished_scene(scene: Scene, limits: MotionLimits, finish: SplineEntry) -> Scene:
    """The scene on a finish's splines, before any of its fields was worked out."""
    return replace(scene, motion=limits, basis=basis_of(finish))


def finished(
    splines: Splines, route: NDArray[np.intp], scene: Scene, finish: SplineEntry
) -> Proposals:
    """Splines as the bundle's own anchors are finished where nothing else is asked.

    route: [N] the place of the route that each follows
    """
    states = scene.basis.own_time_states(splines.control)
    lasting = np.broadcast_to(np.log(splines.duration)[:, None, None], (*states.shape[:2], 1))
    refiner = Refiner(scene, finish.steps, finish.rate)
    refined = refiner.refine(np.concatenate([states, lasting], -1, dtype=np.float32), route, finish)
    arrays = (refined.positions, refined.velocities, refined.accelerations)
    position, velocity, acceleration = (array.astype(np.float64) for array in arrays)
    dt = refined.duration / (NUM_SAMPLES - 1)
    scores = refined.scores.astype(np.float64)
    return Proposals(position, velocity, acceleration, dt, refined.safe, scores)
