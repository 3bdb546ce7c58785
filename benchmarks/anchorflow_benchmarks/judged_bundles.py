"""The bundles that can be asked of a scene's cost map, as every benchmark here does."""

from __future__ import annotations

from pathlib import Path

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_service.bundle import Bundle, load_bundle

COST_MAP = "cost_map"


def open_bundle(folder: Path) -> Bundle:
    """A bundle whose planner is conditioned on a cost map.

    Raises:
        BundleError: the bundle is broken.
        BenchmarkError: its planner takes no cost map, so that these scenes cannot be asked of it
            and their judge (clearance, shortest path, homology) has nothing to look at.
    """
    bundle = load_bundle(folder)
    kind = bundle.card.conditioning.kind
    if kind != COST_MAP:
        raise BenchmarkError(
            f"{bundle.card.name}: expected a planner of cost maps, got conditioning {kind!r}; "
            "the judge of anchors on a cost map does not apply to it"
        )
    return bundle
