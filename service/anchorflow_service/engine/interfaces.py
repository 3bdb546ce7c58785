"""The interfaces of the engine's parts.

    conditioning   a request      -> its scenes, each with the inputs of the graphs
    sampler        a scene        -> context -> samples
    finish         the samples    -> the arrays of the answer
    graphs         named arrays   -> named arrays, by onnxruntime or by torch

A new kind of part is an entry of the manifest, a class in this package, and a line in its registry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorRequest, ResolvedRequest, TensorSpec
from anchorflow_service.bundle.manifest import Manifest

Array = NDArray[Any]
Arrays = dict[str, Array]
Context = Mapping[str, Array]
DT = "dt"
"""Name of [N] s between two time steps among the arrays of a finish, if anchors have their own."""
SAFE = "safe"
"""Name of [N] among the arrays of a finish that says it only where a request asks."""
Check = Callable[[], object]
"""Called between the steps of a request; an exception that it raises ends the request."""


class BoundGraph(Protocol):
    """A graph with some of its inputs fixed, for a loop."""

    def __call__(self, inputs: Mapping[str, Any], *, outputs: Mapping[str, Any]) -> None:
        """Run on the fixed inputs and these; write the outputs into the given arrays."""


class Graphs(Protocol):
    """A planner's graphs, run by role: named arrays in, named arrays out.

    `OnnxGraphs` runs a bundle's, `anchorflow_models.torch_graphs.TorchGraphs` a network's.
    """

    @property
    def device(self) -> Any:
        """The device whose memory onnxruntime computes in; None if it is the host's."""
        ...

    def run(self, role: str, inputs: Mapping[str, Array], *, threads: int = 1) -> Arrays:
        """Run a graph on those of the inputs that it takes; return its outputs in new arrays."""
        ...

    def bind(self, role: str, inputs: Mapping[str, Any]) -> BoundGraph:
        """Fix some inputs of a graph for a loop."""
        ...

    def select(self, role: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """Return those of the arrays that a graph takes by name."""
        ...

    def settle(self, role: str, inputs: Mapping[str, Array]) -> Arrays:
        """Decide whether a graph may run on several threads; return its outputs on one.

        It may if both give the same bytes: on some machines the kernels differ by their threads,
        and an answer must not depend on how busy the service is.
        """
        ...


class ConditionedScene(Protocol):
    """One scene of a request, in the frame that the graphs work in."""

    @property
    def request(self) -> ResolvedRequest:
        """The request, in that frame."""
        ...

    def inputs(self, names: Iterable[str]) -> Arrays:
        """Return inputs of the graphs by name, with a B axis of 1."""
        ...

    def answered(self, arrays: Arrays) -> Arrays:
        """Return the arrays of an answer in the request's own frame."""
        ...


class Conditioning(Protocol):
    """Reads what a planner's requests bring."""

    def faults(self) -> Iterator[str]:
        """Find inputs of the graphs that no request provides."""
        ...

    def scenes(self, request: ResolvedRequest) -> Sequence[ConditionedScene]:
        """Return the scenes of a request. Raises `InvalidRequest` for what the card cannot say."""
        ...

    def probe(self) -> AnchorRequest:
        """Return a request that the planner can answer, to check that a bundle works at all."""
        ...


@dataclass(frozen=True)
class Samples:
    """Anchors as a sampler draws them.

    states: [N,T,S], poses of D components first
    route: [N] index of the route that each began on, empty if the planner has no routes
    arrays: further outputs by name, such as scores [N]
    context: what the sampler encoded, for a finish that reads it
    """

    states: NDArray[np.float32]
    route: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    arrays: Mapping[str, Array] = field(default_factory=dict)
    context: Context = field(default_factory=dict)


class Sampler(Protocol):
    """Draws anchors; several threads may sample at once."""

    def settle(self, scene: ConditionedScene) -> None:
        """Decide on a first scene what must be the same in every answer, whatever its threads."""

    def encode(self, scene: ConditionedScene, *, threads: int) -> Context:
        """Compute what is needed once a scene."""
        ...

    def sample(
        self, scene: ConditionedScene, context: Context, *, threads: int, check: Check
    ) -> Samples:
        """Draw the anchors of a scene; the same to the last bit on any number of threads.

        check: called after every step; an exception that it raises ends the work
        """
        ...


class Finish(Protocol):
    """Turns samples into the arrays of an answer."""

    def finish(self, samples: Samples, scene: ConditionedScene, *, threads: int) -> Arrays:
        """Return the arrays of the contract and those of the sampler, by name: [N,…].

        They are the same to the last bit on any number of threads.
        """
        ...

    def reason(self, arrays: Arrays, scene: ConditionedScene) -> str | None:
        """Return why no anchor is safe in one sentence; None if one is, or if it does not know."""
        ...


def best(scores: Array, count: int) -> NDArray[np.intp]:
    """Return indices [N] of the highest of scores [K], at most `count`; ties keep their order."""
    return np.argsort(-scores, kind="stable")[:count]


def picked(array: Array, chosen: NDArray[np.intp]) -> Array:
    """Return the rows of an array [K,…] that were chosen; 0 for those beyond its end."""
    beyond = chosen >= len(array)
    rows = array[np.where(beyond, 0, chosen)]
    rows[beyond] = 0
    return rows


def names_of_each(extras: Iterable[TensorSpec]) -> set[str]:
    """Return the extras that hold one entry for each anchor: [B,N,…]."""
    return {spec.name for spec in extras if spec.shape[1:2] == ("N",)}


def unknown_names(where: str, names: Iterable[str], known: Iterable[str]) -> Iterator[str]:
    """Find names that no other graph and no request provides."""
    known = tuple(known)
    for name in names:
        if name not in known:
            yield f"{where}: {name!r} is not one of {', '.join(known)}"


def missing_roles(manifest: Manifest, roles: Iterable[str]) -> Iterator[str]:
    """Find graphs that a kind of sampler needs and the manifest lacks."""
    if missing := set(roles) - set(manifest.graphs):
        kind = manifest.sampler.kind
        yield f"graphs: a bundle of kind {kind} needs the role {', '.join(sorted(missing))}"
