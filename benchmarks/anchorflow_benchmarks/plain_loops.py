"""References for the engine's latency: textbook loops, and the floor of a graph's operations.

At every evaluation of the field, a loop encodes the scene again, repeats the context for every
sample, and evaluates one flow time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError
from anchorflow_client.contract import OdeSpec
from anchorflow_service.bundle import Bundle
from anchorflow_service.engine.samplers.flow import PRIOR_MEAN, Beginning
from anchorflow_trajectory.ode.integrate import PlainField, integrate_plainly
from anchorflow_trajectory.ode.methods import method_named

PRODUCT_SIDE = 2048
PRODUCT_FLOPS = 2 * PRODUCT_SIDE**3
COUNTED = ("MatMul", "Gemm", "Conv")
NOT_COUNTED = ("Attention", "Einsum")  # parts of names of operations that contain products

Shape = tuple[int, ...]
Array = NDArray[np.float32]
Arrays = Mapping[str, Array]
Loop = Callable[[Arrays, Beginning, OdeSpec], Array]
"""Inputs of encode, N anchors before the flow, and a sampler -> x_1 [N,T,S]."""


def sample_plainly(field: PlainField, x: Any, sampler: OdeSpec) -> Any:
    """Integrate x [N,T,S], a numpy array or torch tensor, from t = 0 to t = 1."""
    method = method_named(sampler.method)
    return integrate_plainly(field, x, schedule=sampler.schedule, method=method)


class OnnxField:
    """The bundle's graphs with onnxruntime's defaults, run one by one at every evaluation.

    repeat_inputs: repeat the scene for every sample before encoding, as a single graph would
    """

    def __init__(self, bundle: Bundle, *, threads: int, repeat_inputs: bool = False) -> None:
        self._sessions = {
            role: _session(bundle, role, threads) for role in ("encode", "modulate", "field")
        }
        self._repeat_inputs = repeat_inputs

    def of(self, inputs: Arrays, mean: Array | None) -> PlainField:
        """Return the field of one scene, given the inputs of encode with B = 1.

        mean: [N,T,S] of the prior of each sample, or None
        """
        own = {} if mean is None else {PRIOR_MEAN: mean[:, None]}

        def field(x: Array, t: float) -> Array:
            context = {**self._context(inputs, len(x)), **own}
            times = np.array([t], np.float32)
            modulation = self._run("modulate", {**context, "times": times})["modulation"]
            arrays = {**context, "x_t": x[:, None], "modulation": modulation[:, 0]}
            return self._run("field", arrays)["dx_t"][:, 0]

        return field

    def _context(self, inputs: Arrays, count: int) -> Arrays:
        if self._repeat_inputs:
            return self._run("encode", repeated(inputs, count))
        return repeated(self._run("encode", inputs), count)

    def _run(self, role: str, arrays: Arrays) -> dict[str, Array]:
        session = self._sessions[role]
        feeds = {node.name: arrays[node.name] for node in session.get_inputs()}
        names = [node.name for node in session.get_outputs()]
        return dict(zip(names, map(np.asarray, session.run(names, feeds)), strict=True))


def repeated(arrays: Arrays, count: int) -> dict[str, Array]:
    """Copy arrays [1,...] -> [N,...]."""
    return {name: np.repeat(array, count, axis=0) for name, array in arrays.items()}


def _session(bundle: Bundle, role: str, threads: int) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    path = bundle.graph_path(role)
    return ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def onnx_loop(bundle: Bundle, *, threads: int, repeat_inputs: bool = False) -> Loop:
    """Return the plain loop over a bundle's own graphs."""
    graphs = OnnxField(bundle, threads=threads, repeat_inputs=repeat_inputs)
    return lambda inputs, begun, sampler: sample_plainly(
        graphs.of(inputs, begun.mean), begun.x, sampler
    )


def torch_loop(checkpoint: Path, *, threads: int) -> Loop:
    """Return the plain loop over a checkpoint's averaged weights in eager float32 torch.

    Raises `BenchmarkError` if the file is not a checkpoint of FlowMP.
    """
    import torch

    from anchorflow_training.checkpoint import CheckpointError, load_checkpoint, restore_flow

    torch.set_num_threads(threads)
    try:
        model = restore_flow(load_checkpoint(checkpoint))
    except CheckpointError as error:
        raise BenchmarkError(str(error)) from error

    @torch.inference_mode()
    def sample(inputs: Arrays, begun: Beginning, sampler: OdeSpec) -> Array:
        assert begun.mean is not None  # FlowMP's prior is the scene's routes
        tensors = {name: torch.from_numpy(array) for name, array in inputs.items()}
        mean = torch.from_numpy(begun.mean)[:, None]

        def field(x: torch.Tensor, t: float) -> torch.Tensor:
            encoded = model.encode(**tensors)
            context = {n: v.repeat_interleave(len(x), 0) for n, v in encoded.items()}
            modulation = model.modulate(torch.tensor([t]), context)[:, 0]
            return model.field(x[:, None], mean, modulation, context)[:, 0]

        return sample_plainly(field, torch.from_numpy(begun.x), sampler).numpy()

    return sample


def count_flops(path: Path, inputs: Arrays) -> int:
    """Count the floating-point operations of a graph's matrix products and convolutions.

    A multiply-add is two operations. Nothing else is counted, so no implementation can be below
    the floor.

    Raises `BenchmarkError` if the graph has an operation that contains products of its own.
    """
    model = onnx.load(path)
    nodes = [node for node in model.graph.node if node.op_type.endswith(COUNTED)]
    for node in model.graph.node:
        if any(word in node.op_type for word in NOT_COUNTED):
            raise BenchmarkError(f"{path}: the operations of {node.op_type} are not counted")
    shapes = _shapes(
        model, [n for node in nodes for n in (*node.input[:2], node.output[0])], inputs
    )
    return sum(_node_flops(node, shapes) for node in nodes)


def _node_flops(node: onnx.NodeProto, shapes: Mapping[str, Shape]) -> int:
    first, second, out = (shapes[name] for name in (*node.input[:2], node.output[0]))
    if node.op_type.endswith("Conv"):
        terms = int(np.prod(second[1:]))  # of the weight [out, in / groups, ...]
    else:
        flipped = any(a.name == "transA" and a.i for a in node.attribute)
        terms = first[0] if flipped else first[-1]
    return 2 * int(np.prod(out)) * terms


def _shapes(model: onnx.ModelProto, names: list[str], inputs: Arrays) -> dict[str, Shape]:
    """Run the graph, whose axes are symbolic, and return the shapes of its tensors."""
    shapes: dict[str, Shape] = {t.name: tuple(t.dims) for t in model.graph.initializer}
    shapes |= {name: array.shape for name, array in inputs.items()}
    wanted = list(dict.fromkeys(name for name in names if name not in shapes))
    given = {value.name for value in model.graph.output}
    model.graph.output.extend(
        onnx.ValueInfoProto(name=name) for name in wanted if name not in given
    )
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 3
    session = ort.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    arrays = session.run(wanted, dict(inputs))
    return shapes | {name: np.asarray(a).shape for name, a in zip(wanted, arrays, strict=True)}


class MatrixProduct:
    """Multiplies two float32 matrices of 2048 × 2048 when called."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        shape = (PRODUCT_SIDE, PRODUCT_SIDE)
        self._factors = [rng.standard_normal(shape, dtype=np.float32) for _ in range(2)]
        self._out = np.empty(shape, np.float32)

    def __call__(self) -> None:
        np.matmul(*self._factors, out=self._out)
