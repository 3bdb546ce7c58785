"""No finish: anchors are answered as they were sampled."""

from __future__ import annotations

from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.parts import Arrays, ConditionedScene, Samples


class NoFinish:
    """Poses are the first D components of the states."""

    def __init__(self, manifest: Manifest) -> None:
        self._D = manifest.D

    def finish(self, samples: Samples, scene: ConditionedScene) -> Arrays:  # noqa: ARG002 - a Finish's
        """Trajectories [N,T,D], and what the sampler says of them."""
        return {"trajectories": samples.states[..., : self._D], **samples.arrays}
