"""Count the operations of a graph, and time a matrix product: the floor of a request's latency."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError

Shape = tuple[int, ...]
Inputs = Mapping[str, NDArray[np.float32]]

PRODUCT_SIDE = 2048
PRODUCT_FLOPS = 2 * PRODUCT_SIDE**3
COUNTED = ("MatMul", "Gemm", "Conv")
NOT_COUNTED = ("Attention", "Einsum")  # parts of names of operations that contain products


def count_flops(path: Path, inputs: Inputs) -> int:
    """Count the floating-point operations of a graph's matrix products and convolutions.

    A multiply-add is two operations. Nothing else is counted, so no implementation can be below
    the floor.

    Raises:
        BenchmarkError: the graph has an operation that contains products of its own.
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


def _shapes(model: onnx.ModelProto, names: list[str], inputs: Inputs) -> dict[str, Shape]:
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
