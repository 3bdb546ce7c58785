"""Poses: anchors for a robot with an outline and wheels, which are searched and not sampled."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from anchorflow_client.contract.body import DEFAULT_OMEGA_MAX, Kinematics
from anchorflow_service.bundle.manifest import CostMapSpec, Manifest
from anchorflow_service.engine.conditioning.cost_map import MapScene, outline_of
from anchorflow_service.engine.finish import arrays_of
from anchorflow_service.engine.interfaces import Arrays
from anchorflow_service.engine.later_loops import POSE_LOOPS
from anchorflow_service.engine.thread_pool import ThreadPool
from anchorflow_trajectory.bodies.planner import BodyPlanner
from anchorflow_trajectory.bodies.scene import Body, BodyScene
from anchorflow_trajectory.bodies.wheels import Wheels


def wheels_of(kinematics: Kinematics | None) -> Wheels:
    """Return what the wheels of a request allow; without a kind they drive both ways."""
    if kinematics is None:
        return Wheels(DEFAULT_OMEGA_MAX, reverse=True)
    if kinematics.kind == "omni":
        return Wheels(kinematics.omega_max, slides=True)
    return Wheels(
        kinematics.omega_max,
        kinematics.min_turning_radius,
        reverse=kinematics.reverse,
        spot=kinematics.kind != "ackermann",
    )


class PosePlanner:
    """Plans poses for the scenes of requests; its routes and limits are those of other anchors."""

    def __init__(self, manifest: Manifest, *, threads: int) -> None:
        self._steps = manifest.time.steps
        if isinstance(manifest.conditioning, CostMapSpec):
            POSE_LOOPS.load()
        self._pool = ThreadPool(threads, name="anchorflow-poses")

    def plan(self, scene: MapScene, *, threads: int) -> Arrays:
        """Return `arrays_of` anchors with D = 3."""
        request = scene.request
        tolerance = request.goal_tolerance

        def run(work: Sequence[Callable[[], object]]) -> None:
            if threads > 1 and len(work) > 1:
                self._pool.run(work)
                return
            for each in work:
                each()

        problem = BodyScene(
            scene.scene,
            Body(outline_of(request), wheels_of(request.kinematics)),
            (0.0, 0.0) if tolerance is None else (tolerance.position, tolerance.heading),
        )
        found = BodyPlanner(problem, self._steps, run).plan(
            request.num_samples, request.seed, request.certified_margin
        )
        return arrays_of(found, scene, self._steps)
