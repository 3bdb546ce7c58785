"""Counting operations, by hand and by the program."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import onnx.parser
import pytest

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.operations import count_flops

HEADER = '<ir_version: 9, opset_import: ["" : 20]>\n'


@pytest.fixture
def graph(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a graph from its text."""

    def write(text: str) -> Path:
        path = tmp_path / "graph.onnx"
        onnx.save(onnx.parser.parse_model(HEADER + text), path)
        return path

    return write


def array(*shape: int) -> np.ndarray:
    return np.ones(shape, np.float32)


def test_products_inside_a_graph_are_counted(graph: Callable[[str], Path]) -> None:
    path = graph(
        """g (float[N,3,4] x, float[4,5] w, float[5,6] v) => (float[N,3,6] y) {
            h = MatMul (x, w)
            s = Sigmoid (h)
            y = MatMul (s, v)
        }"""
    )
    inputs = {"x": array(7, 3, 4), "w": array(4, 5), "v": array(5, 6)}

    assert count_flops(path, inputs) == 2 * 7 * 3 * (4 * 5 + 5 * 6)


def test_a_transposed_product_is_counted_by_its_common_axis(
    graph: Callable[[str], Path],
) -> None:
    path = graph(
        "g (float[3,2] a, float[3,5] b) => (float[2,5] y) { y = Gemm <transA = 1> (a, b) }"
    )

    assert count_flops(path, {"a": array(3, 2), "b": array(3, 5)}) == 2 * 2 * 5 * 3


def test_a_convolution_is_counted_by_its_kernel(graph: Callable[[str], Path]) -> None:
    path = graph("g (float[1,2,8,8] x, float[4,2,3,3] w) => (float[1,4,6,6] y) { y = Conv (x, w) }")

    assert count_flops(path, {"x": array(1, 2, 8, 8), "w": array(4, 2, 3, 3)}) == (
        2 * 4 * 6 * 6 * 2 * 3 * 3
    )


def test_an_operation_that_hides_its_products_is_refused(graph: Callable[[str], Path]) -> None:
    path = graph(
        """g (float[2,3] a, float[3,5] b) => (float[2,5] y) {
            y = Einsum <equation = "ij,jk->ik"> (a, b)
        }"""
    )
    with pytest.raises(BenchmarkError, match="Einsum"):
        count_flops(path, {"a": array(2, 3), "b": array(3, 5)})
