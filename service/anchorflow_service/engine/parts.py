"""What the engine is put together of: conditioning, sampler and finish, each of a kind.

    conditioning   a request      -> its scenes, each with the inputs of the graphs
    sampler        a scene        -> context -> samples
    finish         the samples    -> the arrays of the answer

A new kind is an entry of the manifest, a class in one of the three folders, and a line in its
registry.
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
"""Among the arrays of a finish: [N] s between two time steps, where anchors have their own."""
Check = Callable[[], object]
"""Called between the steps of a request; what it raises ends the request."""


class ConditionedScene(Protocol):
    """One scene of a request, in the frame that the graphs work in."""

    @property
    def request(self) -> ResolvedRequest:
        """The request, in that frame."""
        ...

    def inputs(self, names: Iterable[str]) -> Arrays:
        """Inputs of the graphs by name, with a B axis of 1."""
        ...

    def answered(self, arrays: Arrays) -> Arrays:
        """The arrays of an answer, in the frame of the request as it came."""
        ...


class Conditioning(Protocol):
    """How a planner is asked."""

    def faults(self) -> Iterator[str]:
        """What keeps the graphs from being fed with what a request brings."""
        ...

    def scenes(self, request: ResolvedRequest) -> Sequence[ConditionedScene]:
        """The scenes of a request. Raises `InvalidRequest` for what the card does not tell."""
        ...

    def probe(self) -> AnchorRequest:
        """A request that the planner can answer, to find out that a bundle works at all."""
        ...


@dataclass(frozen=True)
class Samples:
    """Anchors as a sampler draws them.

    states: [N,T,S], poses of D components first
    route: [N] the place of the route that each began on, empty where the planner has no routes
    arrays: what the graphs say of them beside, by name, such as scores [N]
    """

    states: NDArray[np.float32]
    route: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    arrays: Mapping[str, Array] = field(default_factory=dict)


class Sampler(Protocol):
    """How anchors are drawn; several threads may sample at once."""

    def settle(self, scene: ConditionedScene) -> None:
        """Find out on a first scene what every answer must agree on, whatever its threads."""
        ...

    def encode(self, scene: ConditionedScene, *, threads: int) -> Context:
        """What is worked out once a scene."""
        ...

    def sample(
        self, scene: ConditionedScene, context: Context, *, threads: int, check: Check
    ) -> Samples:
        """The anchors of a scene; the same to the last bit on however many threads.

        check: called after every step; what it raises ends the work and is raised
        """
        ...


class Finish(Protocol):
    """What is done to samples before they are answered."""

    def finish(self, samples: Samples, scene: ConditionedScene, *, threads: int) -> Arrays:
        """The arrays of the contract, and those that the sampler gave, by name: [N,…].

        The same to the last bit on however many threads.
        """
        ...


def best(scores: Array, count: int) -> NDArray[np.intp]:
    """Indices [N] of the highest of scores [K], at most `count`; ties in their own order."""
    return np.argsort(-scores, kind="stable")[:count]


def names_of_each(extras: Iterable[TensorSpec]) -> set[str]:
    """The extras that say something of each anchor: [B,N,…]."""
    return {spec.name for spec in extras if spec.shape[1:2] == ("N",)}


def unknown_names(where: str, names: Iterable[str], known: Iterable[str]) -> Iterator[str]:
    """The faults of names that nothing of the others gives."""
    known = tuple(known)
    for name in names:
        if name not in known:
            yield f"{where}: {name!r} is not one of {', '.join(known)}"


def missing_roles(manifest: Manifest, roles: Iterable[str]) -> Iterator[str]:
    """The fault of graphs that a kind of sampler cannot do without."""
    if missing := set(roles) - set(manifest.graphs):
        kind = manifest.sampler.kind
        yield f"graphs: a bundle of kind {kind} needs the role {', '.join(sorted(missing))}"
