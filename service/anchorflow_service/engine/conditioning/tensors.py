"""Conditioning on tensors: a request's inputs are the graphs' inputs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from anchorflow_client.contract import AnchorRequest, ResolvedRequest, TensorSpec
from anchorflow_client.contract.inputs import TEXT
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.interfaces import Array, Arrays, unknown_names

PROBE_AXIS = 32
"""Size of an open axis in the probe."""


class TensorConditioning:
    """Reads scenes of named tensors; a missing optional one is replaced by zeros, one long on open
    axes."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest

    def faults(self) -> Iterator[str]:
        """Find inputs of encode that no request brings or brings in another type, and optional ones
        of open size where the graph has a fixed one."""
        given = {spec.name: spec for spec in self._manifest.request.inputs}
        encode = self._manifest.graphs["encode"]
        yield from unknown_names("graphs.encode.inputs", encode.input_names, given)
        for spec in encode.inputs:
            if spec.name in given and spec.dtype != given[spec.name].dtype:
                own = f"{spec.name} is {spec.dtype}"
                yield f"graphs.encode.inputs: {own}, in request.inputs {given[spec.name].dtype}"
            asked = given.get(spec.name)
            if asked and asked.optional and _is_open(asked) and not _is_open(spec):
                told = f"expected a fixed size, got {list(asked.shape)}"
                yield f"request.inputs: {spec.name} is optional, {told}"

    def scenes(self, request: ResolvedRequest) -> list[TensorScene]:
        absent = {
            spec.name: np.asarray(probe_of(spec, open_axis=1))[None]
            for spec in self._manifest.request.inputs
            if spec.optional and spec.name not in request.inputs
        }
        return [TensorScene(request, b, absent) for b in range(request.num_scenes)]

    def probe(self) -> AnchorRequest:
        inputs = {spec.name: probe_of(spec) for spec in self._manifest.request.inputs}
        return AnchorRequest.build(inputs=inputs, seed=0)


@dataclass(frozen=True)
class TensorScene:
    """One scene of a request; absent: replacements of the optional inputs that it left out."""

    request: ResolvedRequest
    index: int
    absent: Arrays

    def inputs(self, names: Iterable[str]) -> Arrays:
        own = slice(self.index, self.index + 1)
        return {
            name: self.absent[name]
            if name in self.absent
            else np.ascontiguousarray(np.asarray(self.request.inputs[name])[own])
            for name in names
        }

    def answered(self, arrays: Arrays) -> Arrays:
        return arrays


def _is_open(spec: TensorSpec) -> bool:
    return any(isinstance(size, str) for size in spec.shape[1:])


def probe_of(spec: TensorSpec, *, open_axis: int = PROBE_AXIS) -> Array | str:
    """Return zeros for an input without its B axis, or the nearest values that the card allows."""
    if spec.dtype == TEXT:
        return "probe"
    low, high = spec.range or (None, None)
    shape = [size if isinstance(size, int) else open_axis for size in spec.shape[1:]]
    return np.full(shape, np.clip(0, low, high), dtype=spec.dtype)
