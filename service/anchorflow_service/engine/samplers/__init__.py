"""Samplers: how anchors are drawn from a bundle's graphs, by the kind that its manifest names.

Each owns the roles of its graphs and says what keeps them from being wired together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.parts import Sampler
from anchorflow_service.engine.samplers.ode import OdeSampler
from anchorflow_service.engine.samplers.truncated_diffusion import TruncatedDiffusionSampler
from anchorflow_service.engine.samplers.vocabulary import VocabularySampler


class SamplerKind(Protocol):
    """A class of samplers."""

    def __call__(self, bundle: Bundle, *, threads: int, provider: str) -> Sampler:
        """The graphs of a bundle, opened. Raises `BundleError`, `ProviderError`."""
        ...

    def faults(self, manifest: Manifest) -> Iterator[str]:
        """What keeps the graphs from being wired together by name."""
        ...


SAMPLERS: Mapping[str, SamplerKind] = {
    "ode": OdeSampler,
    "vocabulary": VocabularySampler,
    "truncated_diffusion": TruncatedDiffusionSampler,
}
