"""Splines that meet both ends, pushed clear of obstacles, and measured."""

from __future__ import annotations

from anchorflow_client.contract import RefineSpec
from anchorflow_service.bundle.manifest import Manifest, SplineEntry
from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.parts import Arrays, ConditionedScene, Samples
from anchorflow_trajectory.refine import Refiner


def refiner_of(manifest: Manifest, scene: MapScene) -> Refiner:
    """The splines of a manifest whose finish is one, over the scene's limits."""
    entry = manifest.finish
    assert isinstance(entry, SplineEntry)
    return Refiner.of(
        scene.motion_limits,
        num_steps=manifest.time.steps,
        num_control_points=entry.num_control_points,
        degree=entry.degree,
        steps=entry.steps,
    )


class SplineFinish:
    """What `anchorflow_trajectory` does, on the spline that the manifest describes."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest

    def finish(self, samples: Samples, scene: ConditionedScene) -> Arrays:
        """Anchors that meet both ends, and what they are worth."""
        assert isinstance(scene, MapScene)
        spec = scene.request.refine
        assert isinstance(spec, RefineSpec)
        ends = scene.inputs(("x_curr", "x_goal", "w_style"))
        refined = refiner_of(self._manifest, scene).refine(
            samples.states,
            scene.scene.cost_fields,
            **{name: array[0] for name, array in ends.items()},
            spec=spec,
        )
        return {
            "trajectories": refined.positions,
            "velocities": refined.velocities,
            "accelerations": refined.accelerations,
            "scores": refined.scores,
            "clearance": refined.clearance,
            "safe": refined.safe,
            **samples.arrays,
        }
