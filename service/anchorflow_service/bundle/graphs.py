"""The graphs of a bundle in onnxruntime: named arrays in, named arrays out.

`OnnxGraphs` runs them by role, as the engine's samplers do; `Graph` is one of them, opened.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from anchorflow_client.contract import TensorSpec
from anchorflow_service.bundle.providers import (
    DEFAULT_PROVIDER,
    DEVICES,
    check_obtained,
    preferences,
    provider_named,
)
from anchorflow_service.bundle.reader import Bundle, BundleError

Array = NDArray[Any]
Tensor = Array | ort.OrtValue
"""An array in the host's memory, or a value on a device."""
AnyTensor = TypeVar("AnyTensor", bound=Tensor)

ONNX_TYPES = {
    "float32": "tensor(float)",
    "float64": "tensor(double)",
    "int64": "tensor(int64)",
    "uint8": "tensor(uint8)",
    "bool": "tensor(bool)",
}
ONLY_ERRORS = 3  # onnxruntime's severity; its warnings do not help a caller


class OnnxGraphs:
    """The graphs of a bundle, by role; several threads may run them at once.

    A graph runs on one thread unless `settle` was called for it.

    threads: onnxruntime's own within one call; the calling thread is one of them
    provider: "cpu", "cuda", "tensorrt" or "openvino"

    Raises:
        BundleError, ProviderError: as `open_graph`.
    """

    def __init__(
        self, bundle: Bundle, *, threads: int = 1, provider: str = DEFAULT_PROVIDER
    ) -> None:
        self._bundle, self._threads, self._provider = bundle, threads, provider
        self.device = DEVICES.get(provider)
        self._narrow = {
            role: open_graph(bundle, role, provider=provider) for role in bundle.manifest.graphs
        }
        self._wide: dict[str, Graph] = {}

    def run(self, role: str, inputs: Mapping[str, Array], *, threads: int = 1) -> dict[str, Array]:
        wide = self._wide.get(role) if threads > 1 else None
        graph = wide or self._narrow[role]
        return graph(**graph.select(inputs))

    def bind(self, role: str, inputs: Mapping[str, Tensor]) -> BoundGraph:
        return BoundGraph(self._narrow[role], self.select(role, inputs))

    def select(self, role: str, arrays: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return self._narrow[role].select(arrays)

    def settle(self, role: str, inputs: Mapping[str, Array]) -> dict[str, Array]:
        narrow = self._narrow[role]
        taken = narrow.select(inputs)
        outputs = narrow(**taken)
        if self._threads > 1:
            wide = open_graph(self._bundle, role, threads=self._threads, provider=self._provider)
            others = wide(**taken)
            if all(np.array_equal(outputs[name], others[name]) for name in outputs):
                self._wide[role] = wide
        return outputs


class Graph:
    """An inference session with the manifest's signature; safe to call from several threads.

    threads: onnxruntime's own within one call; the calling thread is one of them
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
        outputs: Sequence[Any] = self.session.run(self.output_names, inputs)
        return dict(zip(self.output_names, outputs, strict=True))

    def select(self, arrays: Mapping[str, AnyTensor]) -> dict[str, AnyTensor]:
        return {name: arrays[name] for name in self.input_names if name in arrays}


class BoundGraph:
    """A graph with some of its inputs fixed; each loop has its own, threads do not share it.

    A value on the device of the graph's provider is used there. An array crosses to the device and
    back at every call unless it is fixed.
    """

    def __init__(self, graph: Graph, inputs: Mapping[str, Tensor]) -> None:
        self._session = graph.session
        self._binding = graph.session.io_binding()
        # The binding borrows the tensors' memory, so they live as long as it does.
        self._fixed = dict(inputs)
        self._bind_inputs(self._fixed)

    def __call__(self, inputs: Mapping[str, Tensor], *, outputs: Mapping[str, Tensor]) -> None:
        """Run on the fixed inputs and these; write the outputs into the given tensors.

        The outputs are complete on return, for another graph to read too: onnxruntime waits for
        the device at the end of every run by default.
        """
        # Bind again at each call, though the inputs may be the same: for a node on another device
        # an input is copied when it is bound, not when it is read.
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


def open_graph(
    bundle: Bundle, role: str, *, threads: int = 1, provider: str = DEFAULT_PROVIDER
) -> Graph:
    """Open a role's graph. Raises `BundleError` or `ProviderError`."""
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
    # Idle threads that spin would take cores from the other graphs and from refinement.
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
    """Find inputs or outputs of a graph that differ from the manifest's."""
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
    """Numbers have to be equal; a letter is an axis that the graph leaves open."""
    return len(onnx_shape) == len(shape) and all(
        got == axis if isinstance(axis, int) else not isinstance(got, int)
        for got, axis in zip(onnx_shape, shape, strict=True)
    )
