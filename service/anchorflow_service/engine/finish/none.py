"""No finish: anchors are answered as they were sampled."""

from __future__ import annotations

from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.parts import Arrays, ConditionedScene, Samples


class NoFinish:
    """Poses are the first D components of the states."""

    def __init__(self, manifest: Manifest, *, threads: int) -> None:  # noqa: ARG002 - a Finish's
        self._D = manifest.D

    def finish(
        self,
        samples: Samples,
        scene: ConditionedScene,  # noqa: ARG002 - a Finish's
        *,
        threads: int,  # noqa: ARG002
    ) -> Arrays:
        """Trajectories [N,T,D], and what the sampler says of them."""
        return {"trajectories": samples.states[..., : self._D], **samples.arrays}
