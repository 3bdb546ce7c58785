"""Splines that meet both ends, pushed clear of obstacles, and measured."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise

from anchorflow_client.contract import RefineSpec
from anchorflow_service.bundle.manifest import Manifest, SplineEntry
from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.parts import DT, Arrays, ConditionedScene, Samples
from anchorflow_service.engine.side_by_side import Helpers
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.threads import Spread, in_one
from anchorflow_trajectory.warm_up import compile_loops

MIN_PART = 16  # anchors; a thread that gets fewer costs more than it brings


def refiner_of(manifest: Manifest, scene: MapScene, *, spread: Spread = in_one) -> Refiner:
    """How a manifest whose finish is one of splines finishes the anchors of a scene."""
    entry = manifest.finish
    assert isinstance(entry, SplineEntry)
    return Refiner(scene.scene, entry.steps, entry.rate, spread)


class SplineFinish:
    """What `anchorflow_trajectory` does, on the spline that the manifest describes.

    Its loops are compiled when the first of these is made.
    """

    def __init__(self, manifest: Manifest, *, threads: int) -> None:
        self._manifest = manifest
        self._helpers = Helpers(threads, name="anchorflow-finish")
        compile_loops()

    def finish(self, samples: Samples, scene: ConditionedScene, *, threads: int) -> Arrays:
        """Anchors that meet both ends, and what they are worth."""
        assert isinstance(scene, MapScene)
        spec = scene.request.refine
        assert isinstance(spec, RefineSpec)

        def spread(work: Callable[[int, int], None], count: int) -> None:
            parts = max(1, min(threads, count // MIN_PART))
            bounds = [count * part // parts for part in range(parts + 1)]
            self._helpers.side_by_side([partial(work, *ends) for ends in pairwise(bounds)])

        refiner = refiner_of(self._manifest, scene, spread=spread)
        refined = refiner.refine(samples.states, samples.route, spec)
        steps = self._manifest.time.steps - 1
        own = {DT: refined.duration / steps} if scene.limits.horizon_s is None else {}
        return {
            "trajectories": refined.positions,
            "velocities": refined.velocities,
            "accelerations": refined.accelerations,
            "scores": refined.scores,
            "clearance": refined.clearance,
            "safe": refined.safe,
            **own,
            **samples.arrays,
        }
