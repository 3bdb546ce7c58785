"""Samplers: draw anchors with a planner's graphs, by the kind that the manifest names.

Each kind owns the roles of its graphs and finds what keeps them from fitting together.
"""

from __future__ import annotations

from collections.abc import Mapping

from anchorflow_service.engine.samplers.ode import OdeSampler
from anchorflow_service.engine.samplers.truncated_diffusion import TruncatedDiffusionSampler
from anchorflow_service.engine.samplers.vocabulary import VocabularySampler

SAMPLERS: Mapping[
    str, type[OdeSampler] | type[VocabularySampler] | type[TruncatedDiffusionSampler]
] = {
    "ode": OdeSampler,
    "vocabulary": VocabularySampler,
    "truncated_diffusion": TruncatedDiffusionSampler,
}
