"""The vocabulary sampler: the best N of a fixed number of trajectories.

    encode   the request's inputs     -> context, or all that follows
    score    the context (optional)   -> trajectories [K,T,D], scores [K], extras

A planner that takes pictures and a text has the graph `vision` before them (`vision_language.py`).
Either graph may give any of them. Without scores the trajectories keep the order of the graph; with
a route in the request those that end beside it lose score (`along_route.py`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from anchorflow_service.bundle.entries import VisionLanguageEntry
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.along_route import AlongRoute
from anchorflow_service.engine.conditioning.vision_language import Views, view_faults
from anchorflow_service.engine.interfaces import (
    Arrays,
    Check,
    ConditionedScene,
    Context,
    Graphs,
    Samples,
    best,
    missing_roles,
    names_of_each,
    picked,
    unknown_names,
)

TRAJECTORIES, SCORES = "trajectories", "scores"


class VocabularySampler:
    """Samples with the graphs of a "vocabulary" planner; several threads may sample at once."""

    def __init__(self, manifest: Manifest, graphs: Graphs, *, threads: int) -> None:  # noqa: ARG002
        self._graphs, self._encode_inputs = graphs, manifest.graphs["encode"].input_names
        self._is_scored, self._along = "score" in manifest.graphs, AlongRoute(manifest)
        looks = isinstance(manifest.conditioning, VisionLanguageEntry)
        self.views = Views(manifest, graphs) if looks else None
        self._of_each = names_of_each(manifest.sampled_extras)
        self._extras = {spec.name for spec in manifest.sampled_extras}

    @staticmethod
    def faults(manifest: Manifest) -> Iterator[str]:
        """Find roles, inputs and outputs that are missing."""
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
        extras = [spec.name for spec in manifest.sampled_extras]
        yield from unknown_names("answer", [TRAJECTORIES, *scores, *extras], given)

    def settle(self, scene: ConditionedScene) -> None:
        if self.views:
            self.views.settle(scene)
        context = self._graphs.settle("encode", self._inputs(scene, threads=1))
        if self._is_scored:
            self._graphs.settle("score", context)

    def encode(self, scene: ConditionedScene, *, threads: int) -> Context:
        return self._graphs.run("encode", self._inputs(scene, threads=threads), threads=threads)

    def _inputs(self, scene: ConditionedScene, *, threads: int) -> Arrays:
        """Return the inputs of encode: the features of pictures, and the scene's own."""
        seen = self.views.features(scene, threads=threads) if self.views else {}
        return seen | scene.inputs(name for name in self._encode_inputs if name not in seen)

    def sample(
        self, scene: ConditionedScene, context: Context, *, threads: int, check: Check
    ) -> Samples:
        """Return the best N by their scores, the best first."""
        check()
        given: Arrays = {**context}
        if self._is_scored:
            given |= self._graphs.run("score", context, threads=threads)
            check()
        trajectories = given[TRAJECTORIES][0]
        scores = given[SCORES][0] if SCORES in given else None
        if scores is not None:
            scores = self._along.scored(scores, trajectories, scene)
            scores, trajectories = self._along.among_drives(scores, trajectories, scene, given)
        ranks = np.zeros(len(trajectories)) if scores is None else scores
        chosen = best(ranks, scene.request.num_samples)
        arrays = {name: given[name][0] for name in self._extras}
        arrays = {
            name: picked(a, chosen) if name in self._of_each else a for name, a in arrays.items()
        }
        if scores is not None:
            arrays[SCORES] = scores[chosen]
        return Samples(trajectories[chosen], arrays=arrays)
