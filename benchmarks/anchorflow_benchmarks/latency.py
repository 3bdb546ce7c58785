"""Latency: a whole request in this process, against the plain loops and the machine's floor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.operations import PRODUCT_FLOPS, MatrixProduct, count_flops
from anchorflow_benchmarks.plain_loop import Array, Arrays, OnnxField, sample_plainly
from anchorflow_benchmarks.planners import request_of
from anchorflow_benchmarks.report import ResultTable
from anchorflow_benchmarks.samplers import evaluations, sampler_name
from anchorflow_benchmarks.turns import p50, p99, take_turns
from anchorflow_client.contract import OdeSpec, ResolvedRequest, resolve_for_card
from anchorflow_service.bundle import Bundle
from anchorflow_service.engine import Engine
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning
from anchorflow_service.engine.samplers.flow_score import PRIOR_MEAN
from anchorflow_service.engine.samplers.ode import Beginning, OdeSampler
from anchorflow_trajectory.scene import Scene

SEED = 1
STAGES = ("encode", "sample", "refine", "total")
REST_S = 0.1
"""Between two calls: OpenBLAS's threads spin for some 25 ms after a product, onnxruntime's for a
while too, and a request that begins meanwhile has one core. A robot asks ten times a second."""
SAME_STATE = {"float32": 1e-2, "int8": 0.5}
"""m, m/s, m/s^2 by which loops of the same weights may differ at t = 1, by the field's precision: a
sum's last bit tips the rounding to eight bits, at each of 32 evaluations."""

Loop = Callable[[Arrays, Beginning, OdeSpec], Array]
"""Inputs of encode, N anchors before the flow and a sampler -> x_1 [N,T,S]."""


@dataclass(frozen=True)
class LatencyConfig:
    """threads: that each contender may keep busy; rounds, budget_s: as `take_turns` takes them"""

    counts: Sequence[int] = (1, 16, 64, 256)
    rounds: int = 30
    budget_s: float = 20.0
    threads: int = 1


@dataclass(frozen=True)
class Contest:
    """One bundle with one sampler, and the loops that it is compared with, by name."""

    name: str
    bundle: Bundle
    sampler: OdeSpec
    loops: dict[str, Loop] = field(default_factory=dict)


def onnx_loop(bundle: Bundle, *, threads: int, repeat_inputs: bool = False) -> Loop:
    """The naive loop over a bundle's own graphs."""
    graphs = OnnxField(bundle, threads=threads, repeat_inputs=repeat_inputs)
    return lambda inputs, begun, sampler: sample_plainly(
        graphs.of(inputs, begun.mean), begun.x, sampler
    )


def torch_loop(checkpoint: Path, *, threads: int) -> Loop:
    """The plain loop over a checkpoint; torch is loaded for this alone."""
    from anchorflow_benchmarks.torch_loop import TorchLoop

    return TorchLoop(checkpoint, threads=threads).sample


def latency_tables(
    contests: Sequence[Contest],
    scenes: Sequence[Scene],
    config: LatencyConfig,
    progress: Callable[[str], None] = lambda _: None,
) -> list[ResultTable]:
    """Times of a request by stage, and their ratios to the loops and to the floor.

    Raises:
        BenchmarkError: a loop's anchors are not the engine's, so it does not do the same work.
    """
    stages, ratios = [], []
    with threadpool_limits(config.threads):
        for contest in contests:
            engine = Engine(contest.bundle, threads=config.threads)
            for num in config.counts:
                progress(f"{contest.name}, N = {num}")
                measured = _measure(contest, engine, scenes, num, config)
                head = {
                    "model": contest.name,
                    "sampler": sampler_name(contest.sampler),
                    "N": num,
                    "evaluations": evaluations(contest.sampler),
                }
                stages.append(head | measured.stage_row())
                ratios.append(head | measured.ratio_row())
    note = (
        f"threads: {config.threads}; medians of {config.rounds} rounds, fewer where a call is slow"
    )
    return [
        ResultTable("A request in this process, ms", stages, note),
        ResultTable("Against the floor, a 2048³ float32 product and plain loops", ratios, note),
    ]


@dataclass(frozen=True)
class Measured:
    """stages, loops: times in ms by name; flops: of the field in one sample; product: ms"""

    stages: dict[str, list[float]]
    loops: dict[str, list[float]]
    product: list[float]
    flops: int

    @property
    def floor_ms(self) -> float:
        return self.flops * p50(self.product) / PRODUCT_FLOPS

    def stage_row(self) -> dict[str, float | int]:
        total = self.stages["total"]
        row: dict[str, float | int] = {f"{s} p50": p50(self.stages[s]) for s in STAGES}
        return row | {"total p99": p99(total), "requests": len(total)}

    def ratio_row(self) -> dict[str, float]:
        total, sample = p50(self.stages["total"]), p50(self.stages["sample"])
        row = {
            "floor ms": self.floor_ms,
            "sample / floor": sample / self.floor_ms,
            "total / floor": total / self.floor_ms,
            "product ms": p50(self.product),
            "total / product": total / p50(self.product),
        }
        for name, times in self.loops.items():
            row |= {f"{name} ms": p50(times), f"total / {name}": total / p50(times)}
        return row


def _measure(
    contest: Contest, engine: Engine, scenes: Sequence[Scene], num: int, config: LatencyConfig
) -> Measured:
    asked = [request_of(s, num=num, seed=SEED, sampler=contest.sampler) for s in scenes]
    requests = [resolve_for_card(request, engine.card) for request in asked]
    work = _sampling_work(contest.bundle, requests[0])
    _check_same_work(contest, work)
    stages: dict[str, list[float]] = {stage: [] for stage in STAGES}
    ahead = cycle(requests)

    def ask_engine() -> None:
        timing = engine.plan(next(ahead)).timing_ms
        for stage, times in stages.items():
            times.append(timing[stage])

    calls: dict[str, Callable[[], object]] = {"engine": ask_engine, "product": MatrixProduct()}
    for name, loop in contest.loops.items():
        calls[name] = lambda loop=loop: loop(work.inputs, work.begun, contest.sampler)
    times = take_turns(calls, rounds=config.rounds, budget_s=config.budget_s, rest_s=REST_S)
    warm = {stage: values[1:] for stage, values in stages.items()}
    warm["total"] = times.pop("engine")  # seen from outside: the request's checks belong to it
    flops = _field_flops(contest.bundle, work, num) * evaluations(contest.sampler)
    return Measured(warm, times, times.pop("product"), flops)


@dataclass(frozen=True)
class SamplingWork:
    """What a loop is given, [1,...] and N anchors, and what the engine makes of it."""

    inputs: Arrays
    context: Arrays
    begun: Beginning
    flow: OdeSampler


def _sampling_work(bundle: Bundle, request: ResolvedRequest) -> SamplingWork:
    scene = CostMapConditioning(bundle.manifest).scenes(request)[0]
    inputs = scene.inputs(bundle.manifest.graphs["encode"].input_names)
    flow = OdeSampler(bundle, threads=1)
    context = dict(flow.encode(scene))
    noise = flow.draw_noise(context, num_samples=request.num_samples, seed=SEED)
    return SamplingWork(inputs, context, flow.beginning(context, noise), flow)


def _check_same_work(contest: Contest, work: SamplingWork) -> None:
    """A few of the anchors through every loop."""
    begun = work.begun
    few = Beginning(begun.x[:2], begun.route[:2], None if begun.mean is None else begun.mean[:2])
    expected = work.flow.integrate(work.context, few, contest.sampler)
    most = SAME_STATE[contest.bundle.manifest.graphs["field"].precision]
    for name, loop in contest.loops.items():
        error = float(np.abs(loop(work.inputs, few, contest.sampler) - expected).max())
        if not error <= most:  # written so that a NaN fails
            raise BenchmarkError(
                f"{contest.name}: the {name} and the engine differ by {error:.2g} at t = 1; "
                "are they the same weights?"
            )


def _field_flops(bundle: Bundle, work: SamplingWork, num: int) -> int:
    """Of one evaluation for `num` samples, from those for one and for two."""
    graph = bundle.manifest.graphs["field"]
    fixed = {name: work.context[name] for name in graph.input_names if name in work.context}
    width = next(int(spec.shape[-1]) for spec in graph.inputs if spec.name == "modulation")
    fixed["modulation"] = np.zeros((1, width), np.float32)
    path, anchor = bundle.graph_path("field"), {"x_t": work.begun.x}
    if work.begun.mean is not None and PRIOR_MEAN in graph.input_names:
        anchor[PRIOR_MEAN] = work.begun.mean
    one, two = (
        count_flops(
            path, fixed | {name: a[None, :1].repeat(n, axis=1) for name, a in anchor.items()}
        )
        for n in (1, 2)
    )
    return one + (num - 1) * (two - one)
