"""What a flow's anchors are worth, where its bundle has a graph that says so.

score   x_1 and prior_mean [B,N,T,S], the context   -> scores [B,N]
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import WideGraph
from anchorflow_service.bundle.manifest import Manifest, NoFinishEntry
from anchorflow_service.engine.parts import Arrays, Context, unknown_names

Array = NDArray[np.float32]

ROLE, SCORES = "score", "scores"
X_1, PRIOR_MEAN = "x_1", "prior_mean"


class FlowScore:
    """The score graph of a bundle, opened.

    Raises:
        BundleError, ProviderError: as `WideGraph`.
    """

    def __init__(self, bundle: Bundle, *, threads: int, provider: str) -> None:
        self._graph = WideGraph(bundle, ROLE, threads=threads, provider=provider)

    def settle(self, context: Context, states: Array, mean: Array | None) -> None:
        """Look whether the graph gives the same bytes on one thread and on many."""
        self._graph.settle(self._inputs(context, states, mean))

    def __call__(
        self, context: Context, states: Array, mean: Array | None, *, threads: int
    ) -> Array:
        """Scores [N] of states [N,T,S] at t = 1 and the prior means that they began on."""
        return self._graph(self._inputs(context, states, mean), threads=threads)[SCORES][0]

    def _inputs(self, context: Context, states: Array, mean: Array | None) -> Arrays:
        own = {X_1: states[None]} | ({} if mean is None else {PRIOR_MEAN: mean[None]})
        return self._graph.select({**context, **own})


def answer_faults(manifest: Manifest, context: Sequence[str], *, mixture: bool) -> Iterator[str]:
    """Inputs of score that nothing gives, and parts of the answer that nothing gives.

    context: names of encode's outputs
    """
    extras = [spec.name for spec in manifest.answer.extras]
    yield from unknown_names("answer.extras", extras, context)
    score, given = manifest.graphs.get(ROLE), ()
    if score is not None:
        known = (X_1, *([PRIOR_MEAN] if mixture else []), *context)
        yield from unknown_names(f"graphs.{ROLE}.inputs", score.input_names, known)
        if score.output_names != (SCORES,):
            names = ", ".join(score.output_names)
            yield f"graphs.{ROLE}.outputs: expected {SCORES}, got {names}"
        given = (SCORES,)
    if isinstance(manifest.finish, NoFinishEntry):
        yield from unknown_names("answer.arrays", manifest.answer.arrays, ("trajectories", *given))
