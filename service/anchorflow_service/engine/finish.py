"""Finishes: what is done to samples before they are answered, by the kind in the manifest.

none     answer the samples as they are
guard    the same, or judge them and make the last one a stop (`guard.py`)
spline   fit splines that meet both ends, push them clear of obstacles, and measure them
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import pairwise

from anchorflow_client.contract import RefineSpec
from anchorflow_service.bundle.entries import SplineEntry
from anchorflow_service.bundle.manifest import RAW_POSITIONS, Manifest
from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.guard import GuardFinish
from anchorflow_service.engine.interfaces import DT, Arrays, ConditionedScene, Finish, Samples
from anchorflow_service.engine.later_loops import MOVING_LOOPS
from anchorflow_service.engine.thread_pool import ThreadPool
from anchorflow_trajectory.finish.refined import Refined
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.finish.why_unsafe import why_unsafe
from anchorflow_trajectory.threads import Spread, in_one

MIN_PART = 16  # anchors; a thread that gets fewer costs more than it saves


class NoFinish:
    """Answers the first D components of the states."""

    def __init__(self, manifest: Manifest, *, threads: int) -> None:  # noqa: ARG002 - a Finish's
        self._D = manifest.D

    def finish(
        self,
        samples: Samples,
        scene: ConditionedScene,  # noqa: ARG002 - a Finish's
        *,
        threads: int,  # noqa: ARG002
    ) -> Arrays:
        return {"trajectories": samples.states[..., : self._D], **samples.arrays}

    def reason(self, arrays: Arrays, scene: ConditionedScene) -> str | None:  # noqa: ARG002
        return None


def refiner_of(manifest: Manifest, scene: MapScene, *, spread: Spread = in_one) -> Refiner:
    """Return the refiner of a scene, for a manifest whose finish is "spline"."""
    entry = manifest.finish
    assert isinstance(entry, SplineEntry)
    return Refiner(scene.scene, entry.steps, entry.rate, spread=spread)


def arrays_of(refined: Refined, scene: MapScene, steps: int) -> Arrays:
    """Return the arrays of an answer, the time steps too if each anchor has its own duration."""
    own = {DT: refined.duration / (steps - 1)} if scene.limits.horizon_s is None else {}
    return {
        "trajectories": refined.positions,
        "velocities": refined.velocities,
        "accelerations": refined.accelerations,
        "scores": refined.scores,
        "clearance": refined.clearance,
        "safe": refined.safe,
        "routes": refined.routes,
        **own,
    }


class SplineFinish:
    """Refines anchors on the spline that the manifest describes.

    The first instance compiles the loops that are not on disk.
    """

    def __init__(self, manifest: Manifest, *, threads: int) -> None:
        self._manifest = manifest
        self._pool = ThreadPool(threads, name="anchorflow-finish")
        MOVING_LOOPS.load()

    def finish(self, samples: Samples, scene: ConditionedScene, *, threads: int) -> Arrays:
        """Return anchors that meet both ends, with their derivatives, scores and clearance."""
        assert isinstance(scene, MapScene)
        spec = scene.request.refine
        assert isinstance(spec, RefineSpec)

        def spread(work: Callable[[int, int], None], count: int) -> None:
            parts = max(1, min(threads, count // MIN_PART))
            bounds = [count * part // parts for part in range(parts + 1)]
            self._pool.run([partial(work, *ends) for ends in pairwise(bounds)])

        refiner = refiner_of(self._manifest, scene, spread=spread)
        refined = refiner.refine(samples.states, samples.route, spec)
        return {
            **arrays_of(refined, scene, self._manifest.time.steps),
            RAW_POSITIONS: samples.states[..., : self._manifest.D],
            **samples.arrays,
        }

    def reason(self, arrays: Arrays, scene: ConditionedScene) -> str | None:
        if arrays["safe"].any():
            return None
        assert isinstance(scene, MapScene)
        margin = scene.request.certified_margin
        return why_unsafe(scene.scene, arrays["clearance"], certified_margin=margin)


FINISHES: Mapping[str, Callable[..., Finish]] = {
    "spline": SplineFinish,
    "guard": GuardFinish,
    "none": NoFinish,
}
