"""The plain loops do the engine's work, and turns are fair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.latency import Contest, LatencyConfig, latency_tables, onnx_loop
from anchorflow_benchmarks.plain_loop import repeated
from anchorflow_benchmarks.samplers import parse_sampler
from anchorflow_benchmarks.scene_files import draw_scenes
from anchorflow_benchmarks.turns import LEAST, p50, p99, take_turns
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits

ONCE = LatencyConfig(counts=(3,), rounds=LEAST, budget_s=0.0, threads=1)


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return load_bundle(DEFAULT_BUNDLE)


@pytest.fixture(scope="module")
def scenes(limits: MotionLimits) -> list[FamilyScene]:
    return draw_scenes(1, 0, limits=limits, cells=32)


def test_what_is_repeated_is_copied() -> None:
    out = repeated({"a": np.arange(3.0, dtype=np.float32)[None]}, 4)["a"]
    assert out.shape == (4, 3)
    assert out.strides[0] > 0


def test_the_engine_and_its_loops_are_measured(bundle: Bundle, scenes: list[FamilyScene]) -> None:
    loops = {
        "ONNX loop": onnx_loop(bundle, threads=1),
        "inputs repeated": onnx_loop(bundle, threads=1, repeat_inputs=True),
    }
    contest = Contest("small", bundle, parse_sampler("midpoint:uniform2", bundle.card), loops)
    stages, ratios = latency_tables([contest], scenes, ONCE)

    (row,), (ratio,) = stages.rows, ratios.rows
    assert (row["model"], row["sampler"], row["N"]) == ("small", "midpoint:uniform2", 3)
    assert row["requests"] == LEAST
    assert float(row["total p50"] or 0) >= float(row["sample p50"] or 0) > 0
    assert ratio["evaluations"] == 4
    assert float(ratio["floor ms"] or 0) > 0
    assert {"total / ONNX loop", "total / inputs repeated"} <= set(ratio)


def test_other_providers_are_asked_by_turns_and_held_against_the_cpu(
    bundle: Bundle, scenes: list[FamilyScene]
) -> None:
    contest = Contest("small", bundle, parse_sampler("midpoint:uniform2", bundle.card))
    *_, elsewhere = latency_tables([contest], scenes, replace(ONCE, providers=("cpu",)))

    (row,) = elsewhere.rows
    assert (row["provider"], row["requests"], row["apart m"]) == ("cpu", LEAST, 0.0)
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
    assert [len(t) for t in take_turns(calls, rounds=50, budget_s=0.0).values()] == [LEAST] * 2


def test_percentiles() -> None:
    assert p50([1.0, 2.0, 10.0]) == 2.0
    assert p99([float(k) for k in range(101)]) == 99.0
