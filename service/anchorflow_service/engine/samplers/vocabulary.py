"""The vocabulary sampler: the best N of a fixed number of trajectories.

    encode   the request's inputs     -> context, or all that follows
    score    the context (optional)   -> trajectories [K,T,D], scores [K], extras

A planner that is asked with pictures and a text has the graph `vision` before them (`views.py`).
Either graph may give any of them. Without scores the trajectories stand in the order of the graph.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import WideGraph
from anchorflow_service.bundle.manifest import Manifest, VisionLanguageEntry
from anchorflow_service.engine.parts import (
    Arrays,
    Check,
    ConditionedScene,
    Context,
    Samples,
    best,
    missing_roles,
    names_of_each,
    unknown_names,
)
from anchorflow_service.engine.samplers.views import Views, view_faults

TRAJECTORIES, SCORES = "trajectories", "scores"


class VocabularySampler:
    """The graphs of a "vocabulary" bundle, opened; several threads may sample at once.

    Raises:
        BundleError: a graph cannot be opened or its signature is not the manifest's.
        ProviderError: the provider is not to be had.
    """

    def __init__(self, bundle: Bundle, *, threads: int, provider: str) -> None:
        self._graphs = {
            role: WideGraph(bundle, role, threads=threads, provider=provider)
            for role in ("encode", "score")
            if role in bundle.manifest.graphs
        }
        looks = isinstance(bundle.manifest.conditioning, VisionLanguageEntry)
        self.views = Views(bundle, threads=threads, provider=provider) if looks else None
        answer = bundle.manifest.answer
        self._of_each = names_of_each(answer.extras)
        self._extras = {spec.name for spec in answer.extras}

    @staticmethod
    def faults(manifest: Manifest) -> Iterator[str]:
        """Roles, inputs and outputs that are missing."""
        if missing := list(missing_roles(manifest, ("encode",))):
            yield from missing
            return
        if isinstance(manifest.conditioning, VisionLanguageEntry):
            yield from view_faults(manifest)
        encode = manifest.graphs["encode"]
        given = encode.output_names
        if score := manifest.graphs.get("score"):
            yield from unknown_names("graphs.score.inputs", score.input_names, given)
            given += score.output_names
        scores = [SCORES] if SCORES in manifest.answer.arrays else []
        extras = [spec.name for spec in manifest.answer.extras]
        yield from unknown_names("answer", [TRAJECTORIES, *scores, *extras], given)

    def settle(self, scene: ConditionedScene) -> None:
        """Look whether each graph gives the same bytes on one thread and on many."""
        if self.views:
            self.views.settle(scene)
        context = self._graphs["encode"].settle(self._inputs(scene, threads=1))
        if score := self._graphs.get("score"):
            score.settle(score.select(context))

    def encode(self, scene: ConditionedScene, *, threads: int) -> Context:
        """What the first graph gives."""
        return self._graphs["encode"](self._inputs(scene, threads=threads), threads=threads)

    def _inputs(self, scene: ConditionedScene, *, threads: int) -> Arrays:
        """Of the first graph: the features of pictures, and what the scene has itself."""
        seen = self.views.features(scene, threads=threads) if self.views else {}
        names = self._graphs["encode"].input_names
        return seen | scene.inputs(name for name in names if name not in seen)

    def sample(
        self, scene: ConditionedScene, context: Context, *, threads: int, check: Check
    ) -> Samples:
        """The best N by their scores, the best first."""
        check()
        given: Arrays = {**context}
        if score := self._graphs.get("score"):
            given |= score(score.select(context), threads=threads)
            check()
        trajectories = given[TRAJECTORIES][0]
        scores = given[SCORES][0] if SCORES in given else None
        ranks = np.zeros(len(trajectories)) if scores is None else scores
        chosen = best(ranks, scene.request.num_samples)
        arrays = {name: given[name][0] for name in self._extras}
        arrays = {name: a[chosen] if name in self._of_each else a for name, a in arrays.items()}
        if scores is not None:
            arrays[SCORES] = scores[chosen]
        return Samples(trajectories[chosen], arrays=arrays)
