"""Time whole requests in this process against plain loops and the machine's floor.

`anchorflow bench latency` prints the stages of a request and their ratios.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from anchorflow_benchmarks import BenchmarkError, options
from anchorflow_benchmarks.field_costs import field_rows
from anchorflow_benchmarks.plain_loops import (
    PRODUCT_FLOPS,
    Arrays,
    Loop,
    MatrixProduct,
    count_flops,
    onnx_loop,
    torch_loop,
)
from anchorflow_benchmarks.planners import (
    bundle_names,
    evaluations,
    limits_of,
    open_bundle,
    parse_sampler,
    request_of,
    sampler_name,
)
from anchorflow_benchmarks.report import ResultTable, report, say
from anchorflow_benchmarks.scene_files import load_scenes
from anchorflow_benchmarks.turns import p50, p99, take_turns
from anchorflow_cli.extras import needs_extra
from anchorflow_client.contract import OdeSpec, ResolvedRequest, resolve_for_card
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle
from anchorflow_service.bundle.graphs import OnnxGraphs
from anchorflow_service.bundle.providers import DEFAULT_PROVIDER
from anchorflow_service.engine import Engine
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning
from anchorflow_service.engine.samplers.flow import PRIOR_MEAN, Beginning
from anchorflow_service.engine.samplers.ode import OdeSampler
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.threads import usable_cores

SEED = 1
FIELDS_NUM = 64
"""Anchors of the requests whose fields are timed."""
STAGES = ("encode", "sample", "refine", "total")
REST_S = 0.1
"""Pause before each call. The threads of OpenBLAS and onnxruntime spin for some 25 ms after a call
and would take a core from the next one."""
SAME_STATE = {"float32": 1e-2, "int8": 0.5}
"""m, m/s, m/s^2, tolerance between loops with the same weights at t = 1, by the field's precision:
the last bit of a sum changes the rounding to eight bits at each of 32 evaluations."""


@dataclass(frozen=True)
class LatencyConfig:
    """threads: per contender; rounds, budget_s: see `take_turns`
    providers: execution providers to time beside the CPU's
    """

    counts: Sequence[int] = (1, 16, 64, 256)
    rounds: int = 30
    budget_s: float = 20.0
    threads: int = 1
    providers: Sequence[str] = ()


@dataclass(frozen=True)
class Contest:
    """One bundle with one sampler, and the loops to compare it with, by name."""

    name: str
    bundle: Bundle
    sampler: OdeSpec
    loops: dict[str, Loop] = field(default_factory=dict)


def latency_tables(
    contests: Sequence[Contest],
    scenes: Sequence[Scene],
    config: LatencyConfig,
    progress: Callable[[str], None] = lambda _: None,
) -> list[ResultTable]:
    """Return the times of a request by stage, and their ratios to the loops and the floor.

    Raises `BenchmarkError` if a loop's anchors differ from the engine's: it does other work;
    `ProviderError` if a provider is not available here.
    """
    stages, ratios, elsewhere = [], [], []
    with threadpool_limits(config.threads):
        for contest in contests:
            engines = {
                provider: Engine(contest.bundle, threads=config.threads, provider=provider)
                for provider in (DEFAULT_PROVIDER, *config.providers)
            }
            for num in config.counts:
                progress(f"{contest.name}, N = {num}")
                measured = _measure(contest, engines, scenes, num, config)
                head = {
                    "model": contest.name,
                    "sampler": sampler_name(contest.sampler),
                    "N": num,
                    "evaluations": evaluations(contest.sampler),
                }
                stages.append(head | measured.stage_row(DEFAULT_PROVIDER))
                elsewhere += [
                    head
                    | {"provider": provider}
                    | measured.stage_row(provider)
                    | {"apart m": apart}
                    for provider, apart in measured.apart.items()
                ]
                ratios.append(head | measured.ratio_row())
    note = (
        f"threads: {config.threads}; medians of {config.rounds} rounds, fewer where a call is slow"
    )
    tables = [
        ResultTable("A request in this process, ms", stages, note),
        ResultTable("Against the floor, a 2048³ float32 product and plain loops", ratios, note),
    ]
    if config.providers:
        note += "; apart: largest difference of a position from the CPU's"
        tables.append(ResultTable("The same by execution provider, ms", elsewhere, note))
    return tables


@dataclass(frozen=True)
class Measured:
    """stages: times in ms by provider and name; loops: ms by name; product: ms
    flops: of the field for one sample; apart: m between anchors and the CPU's, by provider
    """

    stages: dict[str, dict[str, list[float]]]
    loops: dict[str, list[float]]
    product: list[float]
    flops: int
    apart: dict[str, float]

    @property
    def floor_ms(self) -> float:
        return self.flops * p50(self.product) / PRODUCT_FLOPS

    def stage_row(self, provider: str) -> dict[str, float | int]:
        stages = self.stages[provider]
        total = stages["total"]
        row: dict[str, float | int] = {f"{s} p50": p50(stages[s]) for s in STAGES}
        return row | {"total p99": p99(total), "requests": len(total)}

    def ratio_row(self) -> dict[str, float]:
        stages = self.stages[DEFAULT_PROVIDER]
        total, sample = p50(stages["total"]), p50(stages["sample"])
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
    contest: Contest,
    engines: Mapping[str, Engine],
    scenes: Sequence[Scene],
    num: int,
    config: LatencyConfig,
) -> Measured:
    asked = [request_of(s, num=num, seed=SEED, sampler=contest.sampler) for s in scenes]
    requests = [resolve_for_card(request, engines[DEFAULT_PROVIDER].card) for request in asked]
    work = _sampling_work(contest.bundle, requests[0])
    _check_same_work(contest, work)
    timed = {provider: _TimedEngine(engine, requests) for provider, engine in engines.items()}
    calls: dict[str, Callable[[], object]] = {**timed, "product": MatrixProduct()}
    for name, loop in contest.loops.items():
        calls[name] = lambda loop=loop: loop(work.inputs, work.begun, contest.sampler)
    times = take_turns(calls, rounds=config.rounds, budget_s=config.budget_s, rest_s=REST_S)
    # The total includes the request's checks.
    stages = {name: engine.warm() | {"total": times.pop(name)} for name, engine in timed.items()}
    flops = _field_flops(contest.bundle, work, num) * evaluations(contest.sampler)
    apart = {provider: _apart(engines, provider, requests[0]) for provider in config.providers}
    return Measured(stages, times, times.pop("product"), flops, apart)


class _TimedEngine:
    """Plans requests in a cycle and keeps the times that the engine reports."""

    def __init__(self, engine: Engine, requests: Sequence[ResolvedRequest]) -> None:
        self._engine, self._ahead = engine, cycle(requests)
        self._stages: dict[str, list[float]] = {stage: [] for stage in STAGES}

    def __call__(self) -> None:
        timing = self._engine.plan(next(self._ahead)).timing_ms
        for stage, times in self._stages.items():
            times.append(timing[stage])

    def warm(self) -> dict[str, list[float]]:
        """Return the times in ms by stage, without the first call."""
        return {stage: times[1:] for stage, times in self._stages.items()}


def _apart(engines: Mapping[str, Engine], provider: str, request: ResolvedRequest) -> float:
    """Return the largest difference in m between positions on a provider and on the CPU."""
    ours, theirs = (
        engines[each].plan(request).trajectories[..., :2] for each in (DEFAULT_PROVIDER, provider)
    )
    return float(np.abs(ours - theirs).max())


@dataclass(frozen=True)
class SamplingWork:
    """Inputs [1,...] and N anchors for a loop, and the engine's context for them."""

    inputs: Arrays
    context: Arrays
    begun: Beginning
    flow: OdeSampler


def _sampling_work(bundle: Bundle, request: ResolvedRequest) -> SamplingWork:
    scene = CostMapConditioning(bundle.manifest).scenes(request)[0]
    inputs = scene.inputs(bundle.manifest.graphs["encode"].input_names)
    flow = OdeSampler(bundle.manifest, OnnxGraphs(bundle), threads=1)
    context = dict(flow.encode(scene))
    noise = flow.draw_noise(context, num_samples=request.num_samples, seed=SEED)
    return SamplingWork(inputs, context, flow.beginning(context, noise), flow)


def _check_same_work(contest: Contest, work: SamplingWork) -> None:
    """Run a few anchors through every loop."""
    begun = work.begun
    few = Beginning(begun.x[:2], begun.route[:2], None if begun.mean is None else begun.mean[:2])
    expected = work.flow.integrate(work.context, few, contest.sampler)
    most = SAME_STATE[contest.bundle.manifest.graphs["field"].precision]
    for name, loop in contest.loops.items():
        error = float(np.abs(loop(work.inputs, few, contest.sampler) - expected).max())
        if not error <= most:  # true for NaN
            raise BenchmarkError(
                f"{contest.name}: the {name} and the engine differ by {error:.2g} at t = 1; "
                "are they the same weights?"
            )


def _field_flops(bundle: Bundle, work: SamplingWork, num: int) -> int:
    """Count one evaluation for `num` samples, extrapolated from one and two."""
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


def latency(
    *,
    bundle: options.Bundles = None,
    checkpoint: Annotated[
        list[Path] | None,
        typer.Option(help="The bundle's checkpoint, for the torch loop; repeatable, in order."),
    ] = None,
    samplers: options.Samplers = "rk4:8step",
    nums: Annotated[str, typer.Option(metavar="N,N", help="Anchors a request.")] = "1,16,64,256",
    scenes: options.Scenes = "drawn:4:0",
    rounds: Annotated[int, typer.Option(min=3, help="Times that each call is timed.")] = 30,
    budget_s: Annotated[float, typer.Option(help="Seconds after which a slow call rests.")] = 20.0,
    repeat_inputs: Annotated[
        bool, typer.Option("--repeat-inputs", help="Also time ONNX with N encodings a call.")
    ] = False,
    provider: Annotated[
        list[str] | None,
        typer.Option(
            metavar="cuda|tensorrt|openvino", help="Also ask the engine there; repeatable."
        ),
    ] = None,
    threads: options.Threads = None,
    out: options.Out = options.RESULTS,
) -> None:
    """Time a request in this process against plain loops and the machine's floor."""
    bundles = [open_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE]]
    config = LatencyConfig(
        counts=options.whole_numbers(nums, "--nums"),
        rounds=rounds,
        budget_s=budget_s,
        threads=threads or usable_cores(),
        providers=provider or (),
    )
    weights = [*(checkpoint or []), *[None] * len(bundles)]
    if len(checkpoint or []) > len(bundles):
        raise BenchmarkError("expected at most one --checkpoint for each --bundle")
    contests = [
        Contest(name, one, parse_sampler(text, one.card), loops)
        for one, name, path in zip(bundles, bundle_names(bundles), weights, strict=False)
        for loops in [_loops(one, path, config.threads, repeat_inputs=repeat_inputs)]
        for text in samplers.split(",")
    ]
    found = load_scenes(scenes, limits=limits_of(bundles[0]))
    tables = latency_tables(contests, found, config, progress=say)
    with threadpool_limits(config.threads):
        more = [
            ResultTable(
                f"What fields cost: {contest.name}, {sampler_name(contest.sampler)}",
                field_rows(
                    Engine(contest.bundle, threads=config.threads),
                    found,
                    num=FIELDS_NUM,
                    sampler=contest.sampler,
                    rounds=rounds,
                    budget_s=budget_s,
                    rest_s=REST_S,
                ),
            )
            for contest in contests
        ]
    report("Latency", {"scenes": scenes, "threads": str(config.threads)}, tables + more, out)


def _loops(
    bundle: Bundle, checkpoint: Path | None, threads: int, *, repeat_inputs: bool
) -> dict[str, Loop]:
    """Return the loops to compare with; only a checkpoint loads torch."""
    loops = {"ONNX loop": onnx_loop(bundle, threads=threads)}
    if repeat_inputs:
        loops["ONNX loop, inputs repeated"] = onnx_loop(bundle, threads=threads, repeat_inputs=True)
    if checkpoint is not None:
        with needs_extra("train", who="anchorflow bench latency --checkpoint"):
            loops["torch loop"] = torch_loop(checkpoint, threads=threads)
    return loops
