"""The truncated diffusion: a few steps from anchors with a little noise, then the best of many.

    encode    the request's inputs               -> anchors [A,T,2], context, extras
    denoise   x_t [N,T,2], t, the context        -> x_0 [N,T,2], trajectories [N,T,D]
    coarse    what denoise gives, diversity, context
                                                 -> candidates [M,T,D], coarse_scores [M], features
    fine      the best of the candidates         -> scores [K], sub_scores [K,5], extras

x_t, x_0 and the anchors of encode are in the diffusion's own units, everything else in SI's. The
noise is drawn here from the request's seed; what the graphs do with it is deterministic. With a
route in the request, candidates that end beside it lose score (`along_route.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import TruncatedDiffusionSpec
from anchorflow_service.bundle.entries import TruncatedDiffusionEntry
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.along_route import AlongRoute
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
from anchorflow_trajectory.ode.ddim import CLEAN, ddim_step, noised

Array = NDArray[np.float32]

ANCHORS, TRAJECTORIES, CANDIDATES = "anchors", "trajectories", "candidates"
COARSE_SCORES, SCORES = "coarse_scores", "scores"
# Inputs of each role besides the outputs of encode, and the outputs that the loop needs.
FED = {"denoise": ("x_t", "t"), "coarse": (TRAJECTORIES, "diversity"), "fine": (CANDIDATES,)}
NEEDED = {
    "encode": (ANCHORS,),
    "denoise": ("x_0", TRAJECTORIES),
    "coarse": (CANDIDATES, COARSE_SCORES),
    "fine": (SCORES,),
}


@dataclass(frozen=True, eq=False)
class Noise:
    """The random numbers of an answer.

    start: [A G, T, 2], noise that the anchors of each group begin with
    diversity: [A G, V, 2], of each denoised trajectory's variants; 0 for the first
    """

    start: Array
    diversity: Array


class TruncatedDiffusionSampler:
    """Samples with the graphs of a "truncated_diffusion" planner; several threads may at once."""

    def __init__(self, manifest: Manifest, graphs: Graphs, *, threads: int) -> None:  # noqa: ARG002
        assert isinstance(manifest.sampler, TruncatedDiffusionEntry)
        self._manifest, self._graphs, self._entry = manifest, graphs, manifest.sampler
        self._signal = self._entry.noise.signal
        self._T, self._along = manifest.time.steps, AlongRoute(manifest)
        extras = manifest.sampled_extras
        self._of_each = names_of_each(extras)
        self._extras = {spec.name for spec in extras}
        fine = manifest.graphs["fine"]
        coarse = manifest.graphs["coarse"].output_names
        # Outputs of coarse that hold one entry a candidate, of which the best are picked.
        self._by_candidate = {
            name for name in coarse if name in (*fine.input_names, *self._of_each)
        }

    @staticmethod
    def faults(manifest: Manifest) -> Iterator[str]:
        """Find roles, inputs and outputs that are missing."""
        assert isinstance(manifest.sampler, TruncatedDiffusionEntry)
        if missing := list(missing_roles(manifest, NEEDED)):
            yield from missing
            return
        graphs, given = manifest.graphs, manifest.graphs["encode"].output_names
        for role, needed in NEEDED.items():
            yield from unknown_names(f"graphs.{role}.outputs", needed, graphs[role].output_names)
        for role, fed in FED.items():
            where, takes = f"graphs.{role}.inputs", graphs[role].input_names
            yield from unknown_names(where, fed, takes)
            earlier = {"coarse": "denoise", "fine": "coarse"}.get(role)
            before = graphs[earlier].output_names if earlier else ()
            yield from unknown_names(where, takes, (*fed, *before, *given))
        told = (*given, *graphs["coarse"].output_names, *graphs["fine"].output_names)
        extras = [spec.name for spec in manifest.sampled_extras]
        yield from unknown_names("answer.extras", extras, told)
        anchors = next(s.shape for s in graphs["encode"].outputs if s.name == ANCHORS)
        wanted = (manifest.sampler.anchors, manifest.time.steps, 2)
        if anchors[1:] != wanted:
            yield f"graphs.encode.outputs: {ANCHORS} is {[*anchors]}, expected {['B', *wanted]}"

    def settle(self, scene: ConditionedScene) -> None:
        graphs, entry = self._graphs, self._entry
        context = graphs.settle("encode", self._scene_inputs(scene))
        noise = self.draw_noise(seed=0)
        level = self._t(entry.start)
        x_t = self.beginning(context, noise)
        denoised = graphs.settle("denoise", {**context, "x_t": x_t[None], "t": level})
        coarse = graphs.settle(
            "coarse", {**context, **denoised, "diversity": noise.diversity[None]}
        )
        best = self._picked(coarse, np.arange(entry.keep))
        graphs.settle("fine", {**context, **best})

    def encode(self, scene: ConditionedScene, *, threads: int) -> Context:
        return self._graphs.run("encode", self._scene_inputs(scene), threads=threads)

    def _scene_inputs(self, scene: ConditionedScene) -> Arrays:
        return scene.inputs(self._manifest.graphs["encode"].input_names)

    def draw_noise(self, *, seed: int) -> Noise:
        """Draw standard normal noise of a seed."""
        entry, generator = self._entry, np.random.Generator(np.random.PCG64(seed))
        count = entry.anchors * entry.groups
        start = generator.standard_normal((count, self._T, 2), dtype=np.float32)
        diversity = generator.standard_normal((count, entry.variants, 2), dtype=np.float32)
        diversity[:, 0] = 0.0
        return Noise(start, diversity)

    def beginning(self, context: Context, noise: Noise) -> Array:
        """Return x [A G, T, 2] at the first level; every group has each anchor."""
        anchors = np.tile(context[ANCHORS][0], (self._entry.groups, 1, 1))
        return noised(anchors, noise.start, np.float32(self._signal[self._entry.start]))

    def denoised(
        self, context: Context, noise: Noise, *, steps: int, threads: int = 1, check: Check
    ) -> Arrays:
        """Return the outputs of the last of these steps; `check` is called after each."""
        levels = self._entry.levels_of(steps)
        signals = [*(float(self._signal[level]) for level in levels), CLEAN]
        x, outputs = self.beginning(context, noise), {}
        for level, (signal, following) in zip(levels, pairwise(signals), strict=True):
            inputs = {**context, "x_t": x[None], "t": self._t(level)}
            outputs = self._graphs.run("denoise", inputs, threads=threads)
            x = ddim_step(x, outputs["x_0"][0], signal, following=following).astype(np.float32)
            check()
        return outputs

    def sample(
        self, scene: ConditionedScene, context: Context, *, threads: int, check: Check
    ) -> Samples:
        """Return the best N by the fine scores, the best first."""
        request, spec = scene.request, scene.request.sampler
        assert isinstance(spec, TruncatedDiffusionSpec)
        noise = self.draw_noise(seed=request.seed)
        found = self.denoised(context, noise, steps=spec.steps, threads=threads, check=check)
        inputs = {**context, **found, "diversity": noise.diversity[None]}
        coarse = self._graphs.run("coarse", inputs, threads=threads)
        check()
        candidates = coarse[CANDIDATES][0]
        rough = self._along.scored(coarse[COARSE_SCORES][0], candidates, scene)
        few = self._along.kept(rough, candidates, scene, self._entry.keep)
        kept = self._picked(coarse, few)
        given = {**context, **kept}
        given |= self._graphs.run("fine", given, threads=threads)
        candidates = given[CANDIDATES][0]
        scores = self._along.hastened(given[SCORES][0], candidates, scene)
        scores = self._along.scored(scores, candidates, scene)
        scores, candidates = self._along.among_drives(scores, candidates, scene, given)
        chosen = best(scores, request.num_samples)
        arrays = {name: given[name][0] for name in self._extras}
        arrays = {
            name: picked(array, chosen) if name in self._of_each else array
            for name, array in arrays.items()
        }
        return Samples(candidates[chosen], arrays={**arrays, SCORES: scores[chosen]})

    def _picked(self, coarse: Arrays, kept: NDArray[np.intp]) -> Arrays:
        """Return the coarse outputs of some candidates."""
        return {name: np.ascontiguousarray(coarse[name][:, kept]) for name in self._by_candidate}

    def _t(self, level: int) -> Array:
        return np.array([level], np.float32)
