"""The plain loops do the engine's work, turns are fair, operations are counted."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnx.parser
import pytest
import torch
from flowmp_scenes import make_model

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.field_costs import FIELDS, field_rows
from anchorflow_benchmarks.latency import Contest, LatencyConfig, latency_tables, onnx_loop
from anchorflow_benchmarks.plain_loops import count_flops, torch_loop
from anchorflow_benchmarks.planners import parse_sampler
from anchorflow_benchmarks.scene_files import draw_scenes
from anchorflow_benchmarks.turns import MIN_ROUNDS, take_turns
from anchorflow_client.contract import OdeSpec, ResolvedRequest
from anchorflow_models import L2SafetyCFM
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.engine.samplers.flow import Beginning
from anchorflow_training.checkpoint import Checkpoint, save_checkpoint
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits

ONCE = LatencyConfig(counts=(3,), rounds=MIN_ROUNDS, budget_s=0.0, threads=1)


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return load_bundle(DEFAULT_BUNDLE)


@pytest.fixture(scope="module")
def scenes(limits: MotionLimits) -> list[FamilyScene]:
    return draw_scenes(1, 0, limits=limits, cells=32)


def test_the_engine_and_its_loops_are_measured(bundle: Bundle, scenes: list[FamilyScene]) -> None:
    loops = {
        "ONNX loop": onnx_loop(bundle, threads=1),
        "inputs repeated": onnx_loop(bundle, threads=1, repeat_inputs=True),
    }
    contest = Contest("small", bundle, parse_sampler("midpoint:uniform2", bundle.card), loops)
    stages, ratios = latency_tables([contest], scenes, ONCE)

    (row,), (ratio,) = stages.rows, ratios.rows
    assert (row["model"], row["sampler"], row["N"]) == ("small", "midpoint:uniform2", 3)
    assert row["requests"] == MIN_ROUNDS
    assert float(row["total p50"] or 0) >= float(row["sample p50"] or 0) > 0
    assert ratio["evaluations"] == 4
    assert float(ratio["floor ms"] or 0) > 0
    assert {"total / ONNX loop", "total / inputs repeated"} <= set(ratio)


def test_fields_are_timed_by_turns_on_maps_that_are_new(
    bundle: Bundle, scenes: list[FamilyScene]
) -> None:
    sampler = parse_sampler("midpoint:uniform2", bundle.card)
    asked: list[ResolvedRequest] = []

    class Noted(Engine):
        def plan(self, request: ResolvedRequest, **options: Any) -> Any:
            asked.append(request)
            return super().plan(request, **options)

    engine = Noted(bundle, threads=1)
    asked.clear()  # it asks itself at the start
    rows = field_rows(engine, scenes, num=2, sampler=sampler, rounds=3, budget_s=0.0)
    assert [row["request"] for row in rows] == [*FIELDS]
    assert rows[0]["p50 over plain"] == 1.0
    assert all(row["requests"] == MIN_ROUNDS for row in rows)
    assert sum(each.obstacles is not None for each in asked) == MIN_ROUNDS + 1
    assert sum(each.footprint is not None for each in asked) == MIN_ROUNDS + 1
    assert sum(each.cost_map.data.shape[1] == 3 for each in asked) == MIN_ROUNDS + 1
    maps = {each.cost_map.data[:, 0].tobytes() for each in asked}
    assert len(maps) == 1 + (len(FIELDS) - 1) * (MIN_ROUNDS + 1)


def test_other_providers_are_asked_by_turns_and_held_against_the_cpu(
    bundle: Bundle, scenes: list[FamilyScene]
) -> None:
    contest = Contest("small", bundle, parse_sampler("midpoint:uniform2", bundle.card))
    *_, elsewhere = latency_tables([contest], scenes, replace(ONCE, providers=("cpu",)))

    (row,) = elsewhere.rows
    assert (row["provider"], row["requests"], row["apart m"]) == ("cpu", MIN_ROUNDS, 0.0)
    assert float(row["total p50"] or 0) >= float(row["sample p50"] or 0) > 0


def test_a_loop_that_does_other_work_is_found(bundle: Bundle, scenes: list[FamilyScene]) -> None:
    loops = {"lazy loop": lambda _inputs, begun, _sampler: begun.x}
    contest = Contest("small", bundle, parse_sampler("euler:uniform1", bundle.card), loops)

    with pytest.raises(BenchmarkError, match="lazy loop and the engine differ"):
        latency_tables([contest], scenes, ONCE)


def test_calls_alternate_and_a_slow_one_leaves() -> None:
    log: list[str] = []
    calls = {"a": lambda: log.append("a"), "b": lambda: log.append("b")}
    times = take_turns(calls, rounds=20, budget_s=100.0)

    rounds = ["".join(log[begin : begin + 2]) for begin in range(0, len(log), 2)]
    assert len(rounds) == 21  # the first of each is not counted
    assert set(rounds) == {"ab", "ba"}
    assert [len(t) for t in times.values()] == [20, 20]
    assert [len(t) for t in take_turns(calls, rounds=50, budget_s=0.0).values()] == [MIN_ROUNDS] * 2


EULER = OdeSpec("euler", (0.0, 0.5, 1.0))


@pytest.fixture(scope="module")
def model() -> L2SafetyCFM:
    return make_model()


@pytest.fixture
def checkpoint(model: L2SafetyCFM, tmp_path: Path) -> Path:
    config, weights = {"model": asdict(model.config)}, model.state_dict()
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, Checkpoint(1, config, {}, weights, weights, {}, []))
    return path


def scene(channels: int) -> dict[str, np.ndarray]:
    """The inputs of encode for a scene of 6.4 m with a block in its middle."""
    rng = np.random.default_rng(0)
    cost_map = np.zeros((1, channels, 32, 32), np.float32)
    cost_map[0, 0, 14:18, 14:18] = 1.0
    return {
        "cost_map": cost_map,
        "map_geometry": np.array([[-3.2, -3.2, 0.2]], np.float32),
        "clearance_field": rng.uniform(0, 1, (1, 32, 32)).astype(np.float32),
        "x_curr": np.array([[-2, 0, 0.5, 0, 0, 0]], np.float32),
        "x_goal": np.array([[2, 1, 0, 0]], np.float32),
        "w_style": np.array([[0.4, 0.3, 0.3]], np.float32),
        "limits": np.array([[2.0, 3.0, 0.25, 0.0]], np.float32),
    }


def routes() -> torch.Tensor:
    """[1,2,T,S]: two ways from (-2, 0) to (2, 1) in 3 s, one on each side of the block."""
    share = np.linspace(0.0, 1.0, 64)
    states = np.zeros((1, 2, 64, 7), np.float32)
    states[..., 0], states[..., 2] = 4.0 * share - 2.0, 4.0
    for side, route in zip((-1.5, 1.5), states[0], strict=True):
        route[:, 1] = share + side * np.sin(np.pi * share)
        route[:, 3] = 1.0 + side * np.pi * np.cos(np.pi * share)
        route[:, 5] = -side * np.pi**2 * np.sin(np.pi * share)
    states[..., 6] = np.log(3.0)
    return torch.from_numpy(states)


def test_repeating_the_condition_changes_nothing(model: L2SafetyCFM, checkpoint: Path) -> None:
    inputs = scene(model.config.map_channels)
    mean = routes()[:, [0, 1, 0]]
    with torch.inference_mode():
        context = model.encode(**{name: torch.from_numpy(a) for name, a in inputs.items()})
        x = model.draw(torch.randn(1, 3, model.prior.rank), mean, context)
        start = x[0].numpy()
        for t, end in pairwise(EULER.schedule):
            modulation = model.modulate(torch.tensor([t]), context)[:, 0]
            x = x + (end - t) * model.field(x, mean, modulation, context)

    begun = Beginning(start, np.array([0, 1, 0]), mean[0].numpy())
    got = torch_loop(checkpoint, threads=torch.get_num_threads())(inputs, begun, EULER)

    assert np.abs(got - start).max() > 1e-2
    np.testing.assert_allclose(got, x[0].numpy(), atol=1e-4)


def test_a_file_that_is_no_checkpoint_is_named(tmp_path: Path) -> None:
    (tmp_path / "text.pt").write_text("no weights")
    with pytest.raises(BenchmarkError, match=r"text\.pt: not a checkpoint"):
        torch_loop(tmp_path / "text.pt", threads=1)


# Bindings that hold their modules in cycles, which only the collector undoes when the process ends.
TIMED = """
from ompl import base
from anchorflow_benchmarks.turns import spare_the_collector
with spare_the_collector():
    pass
"""


def test_a_process_that_took_timings_ends_quietly() -> None:
    pytest.importorskip("ompl")

    run = subprocess.run(
        [sys.executable, "-c", TIMED], check=True, capture_output=True, text=True, timeout=60
    )

    assert (run.stdout, run.stderr) == ("", "")


HEADER = '<ir_version: 9, opset_import: ["" : 20]>\n'


@pytest.fixture
def graph(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a graph from its text."""

    def write(text: str) -> Path:
        path = tmp_path / "graph.onnx"
        onnx.save(onnx.parser.parse_model(HEADER + text), path)
        return path

    return write


@pytest.mark.parametrize(
    ("text", "shapes", "flops"),
    [
        (
            """g (float[N,3,4] x, float[4,5] w, float[5,6] v) => (float[N,3,6] y) {
                h = MatMul (x, w)
                s = Sigmoid (h)
                y = MatMul (s, v)
            }""",
            {"x": (7, 3, 4), "w": (4, 5), "v": (5, 6)},
            2 * 7 * 3 * (4 * 5 + 5 * 6),
        ),
        (  # transposed: by the common axis
            "g (float[3,2] a, float[3,5] b) => (float[2,5] y) { y = Gemm <transA = 1> (a, b) }",
            {"a": (3, 2), "b": (3, 5)},
            2 * 2 * 5 * 3,
        ),
        (
            "g (float[1,2,8,8] x, float[4,2,3,3] w) => (float[1,4,6,6] y) { y = Conv (x, w) }",
            {"x": (1, 2, 8, 8), "w": (4, 2, 3, 3)},
            2 * 4 * 6 * 6 * 2 * 3 * 3,
        ),
    ],
    ids=["products", "transposed", "convolution"],
)
def test_operations_are_counted(
    text: str, shapes: dict[str, tuple[int, ...]], flops: int, graph: Callable[[str], Path]
) -> None:
    inputs = {name: np.ones(shape, np.float32) for name, shape in shapes.items()}
    assert count_flops(graph(text), inputs) == flops


def test_an_operation_that_hides_its_products_is_refused(graph: Callable[[str], Path]) -> None:
    path = graph(
        """g (float[2,3] a, float[3,5] b) => (float[2,5] y) {
            y = Einsum <equation = "ij,jk->ik"> (a, b)
        }"""
    )
    with pytest.raises(BenchmarkError, match="Einsum"):
        count_flops(path, {"a": np.ones((2, 3), np.float32), "b": np.ones((3, 5), np.float32)})
