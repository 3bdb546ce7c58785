"""Samplers: draw anchors with a planner's graphs, by the kind that the manifest names.

Each kind owns the roles of its graphs and finds what keeps them from fitting together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.interfaces import Graphs, Sampler
from anchorflow_service.engine.samplers.ode import OdeSampler
from anchorflow_service.engine.samplers.truncated_diffusion import TruncatedDiffusionSampler
from anchorflow_service.engine.samplers.vocabulary import VocabularySampler


class SamplerKind(Protocol):
    """A class of samplers."""

    def __call__(self, manifest: Manifest, graphs: Graphs, *, threads: int) -> Sampler:
        """Return a sampler of a planner's graphs."""
        ...

    def faults(self, manifest: Manifest) -> Iterator[str]:
        """Find what keeps the graphs from fitting together by name."""
        ...


SAMPLERS: Mapping[str, SamplerKind] = {
    "ode": OdeSampler,
    "vocabulary": VocabularySampler,
    "truncated_diffusion": TruncatedDiffusionSampler,
}
