"""One ONNX graph, opened: arrays in by name, arrays out by name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from anchorflow_client.contract import TensorSpec
from anchorflow_service.bundle.providers import (
    DEFAULT_PROVIDER,
    check_obtained,
    preferences,
    provider_named,
)
from anchorflow_service.bundle.reader import Bundle, BundleError

Array = NDArray[Any]
Tensor = Array | ort.OrtValue
"""An array in the host's memory, or a value that lies on a device."""

ONNX_TYPES = {
    "float32": "tensor(float)",
    "float64": "tensor(double)",
    "int64": "tensor(int64)",
    "uint8": "tensor(uint8)",
    "bool": "tensor(bool)",
}
ONLY_ERRORS = 3  # onnxruntime's severity; its warnings are of no use to a caller


class Graph:
    """An inference session whose signature is the manifest's; safe to call from several threads.

    threads: onnxruntime's own, within one call; the calling thread is one of them
    provider: "cpu", "cuda", "tensorrt" or "openvino"
    """

    def __init__(
        self,
        path: Path,
        *,
        inputs: Sequence[TensorSpec],
        outputs: Sequence[TensorSpec],
        threads: int = 1,
        provider: str = DEFAULT_PROVIDER,
    ) -> None:
        self.session = _open(path, threads, provider)
        self.input_names = tuple(spec.name for spec in inputs)
        self.output_names = tuple(spec.name for spec in outputs)
        for wrong in _signature_faults("input", self.session.get_inputs(), inputs):
            raise BundleError(path, wrong)
        for wrong in _signature_faults("output", self.session.get_outputs(), outputs):
            raise BundleError(path, wrong)

    def __call__(self, **inputs: Array) -> dict[str, Array]:
        """Outputs by name, in new arrays."""
        outputs: Sequence[Any] = self.session.run(self.output_names, inputs)
        return dict(zip(self.output_names, outputs, strict=True))

    def select(self, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Those of the arrays that the graph takes by name."""
        return {name: arrays[name] for name in self.input_names if name in arrays}

    def bind(self, **inputs: Tensor) -> BoundGraph:
        """The graph with some inputs fixed, for a loop that writes where it is told."""
        return BoundGraph(self, inputs)


class BoundGraph:
    """A graph with some of its inputs fixed; one for each loop, it is not shared by threads.

    What lies on the device of the graph's provider is used where it is. An array crosses to it and
    back, at every call unless it is fixed.
    """

    def __init__(self, graph: Graph, inputs: Mapping[str, Tensor]) -> None:
        self._session = graph.session
        self._binding = graph.session.io_binding()
        # The binding borrows the tensors' memory, so they live as long as it does.
        self._fixed = dict(inputs)
        self._bind_inputs(self._fixed)

    def __call__(self, inputs: Mapping[str, Tensor], *, outputs: Mapping[str, Tensor]) -> None:
        """Run on the fixed inputs and these; the outputs are written into the tensors given.

        They are there when it returns, for another graph to read too: onnxruntime waits for the
        device at the end of every run unless it is told not to.
        """
        # Anew at each call, though they may be the same as before: what a node on another device
        # reads is copied when it is bound, not when it is read.
        self._bind_inputs(inputs)
        for name, tensor in outputs.items():
            if isinstance(tensor, ort.OrtValue):
                self._binding.bind_ortvalue_output(name, tensor)
            else:
                self._binding.bind_output(
                    name, "cpu", 0, tensor.dtype.type, tensor.shape, tensor.ctypes.data
                )
        self._session.run_with_iobinding(self._binding)

    def _bind_inputs(self, inputs: Mapping[str, Tensor]) -> None:
        for name, tensor in inputs.items():
            if isinstance(tensor, ort.OrtValue):
                self._binding.bind_ortvalue_input(name, tensor)
            else:
                self._binding.bind_cpu_input(name, tensor)


class WideGraph:
    """A graph for callers who have one thread and for those who have many.

    Its bytes are the same either way: where this machine's kernels differ with their threads, which
    `settle` finds out, it stays on one.
    """

    def __init__(self, bundle: Bundle, role: str, *, threads: int, provider: str) -> None:
        self._narrow = open_graph(bundle, role, provider=provider)
        self._wide = (
            open_graph(bundle, role, threads=threads, provider=provider)
            if threads > 1
            else self._narrow
        )
        self.input_names = self._narrow.input_names
        self.select = self._narrow.select
        self._is_settled = False

    def settle(self, inputs: Mapping[str, Array]) -> dict[str, Array]:
        """Look whether both give the same; the outputs of the narrow one."""
        narrow, wide = self._narrow(**inputs), self._wide(**inputs)
        self._is_settled = all(np.array_equal(narrow[name], wide[name]) for name in narrow)
        return narrow

    def __call__(self, inputs: Mapping[str, Array], *, threads: int = 1) -> dict[str, Array]:
        """Outputs by name, in new arrays."""
        graph = self._wide if threads > 1 and self._is_settled else self._narrow
        return graph(**inputs)


def open_graph(
    bundle: Bundle, role: str, *, threads: int = 1, provider: str = DEFAULT_PROVIDER
) -> Graph:
    """The graph of a bundle's role.

    Raises:
        BundleError: onnxruntime cannot open it, or its signature is not the manifest's.
        ProviderError: the provider is not to be had.
    """
    entry, path = bundle.manifest.graphs[role], bundle.graph_path(role)
    return Graph(
        path, inputs=entry.inputs, outputs=entry.outputs, threads=threads, provider=provider
    )


def _open(path: Path, threads: int, provider: str) -> ort.InferenceSession:
    wanted = provider_named(provider)
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = ONLY_ERRORS
    # Idle threads that spin take the cores from the other graphs and from refinement.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        session = ort.InferenceSession(path, options, providers=preferences(wanted))
    except Exception as error:  # onnxruntime's exceptions share no public base
        raise BundleError(path, "onnxruntime cannot open it", str(error)) from error
    check_obtained(session, wanted, path)
    return session


def _signature_faults(
    kind: str, nodes: Iterable[Any], specs: Sequence[TensorSpec]
) -> Iterator[str]:
    """Where a graph's inputs or outputs are not those of the manifest."""
    found = {node.name: node for node in nodes}
    if set(found) != {spec.name for spec in specs}:
        names = ", ".join(spec.name for spec in specs)
        yield f"its {kind}s are {', '.join(found)}, the manifest says {names}"
        return
    for spec in specs:
        node = found[spec.name]
        if node.type != ONNX_TYPES.get(spec.dtype):
            yield f"{kind} {spec.name} is {node.type}, the manifest says {spec.dtype}"
        if not _shapes_agree(node.shape, spec.shape):
            yield f"{kind} {spec.name} has shape {node.shape}, the manifest says {[*spec.shape]}"


def _shapes_agree(onnx_shape: Sequence[Any], shape: Sequence[str | int]) -> bool:
    """Numbers stand where numbers stand; a letter is an axis that the graph leaves open."""
    return len(onnx_shape) == len(shape) and all(
        got == axis if isinstance(axis, int) else not isinstance(got, int)
        for got, axis in zip(onnx_shape, shape, strict=True)
    )
