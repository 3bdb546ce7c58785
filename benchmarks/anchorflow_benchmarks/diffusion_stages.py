"""Where the time of a truncated diffusion goes: encode, each step of denoising, both scorers."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.report import ResultTable
from anchorflow_client.contract import AnchorRequest, TruncatedDiffusionSpec, resolve_for_card
from anchorflow_service.bundle import load_bundle
from anchorflow_service.bundle.graphs import WideGraph
from anchorflow_service.engine import Engine
from anchorflow_service.engine.samplers.truncated_diffusion import TruncatedDiffusionSampler

Inputs = dict[str, np.ndarray]

ROLES = ("encode", "denoise", "coarse", "fine")
SEED = 1


@dataclass
class StageTimes:
    """ms of every call by role, on the wall's clock and on the processor's."""

    wall: dict[str, list[float]] = field(default_factory=lambda: {role: [] for role in ROLES})
    processor: dict[str, list[float]] = field(default_factory=lambda: {role: [] for role in ROLES})

    @contextmanager
    def stage(self, role: str) -> Any:
        """Adds the time that is spent inside."""
        wall, processor = perf_counter(), process_time()
        yield
        self.wall[role].append((perf_counter() - wall) * 1e3)
        self.processor[role].append((process_time() - processor) * 1e3)


class TimedGraph:
    """A graph that says how long its calls take."""

    def __init__(self, graph: WideGraph, role: str, times: StageTimes) -> None:
        self._graph, self._role, self._times = graph, role, times
        self.input_names, self.select = graph.input_names, graph.select

    def __call__(self, inputs: Mapping[str, np.ndarray], *, threads: int = 1) -> Inputs:
        with self._times.stage(self._role):
            return self._graph(inputs, threads=threads)


def stage_table(folders: list[Path], *, rounds: int, threads: int) -> ResultTable:
    """A row a bundle and number of steps: the median of each stage, and the processor's least.

    The sensors are random; nothing that is timed depends on what they show.

    Raises:
        BundleError: a bundle is broken.
        BenchmarkError: a bundle is of another kind.
    """
    rows = [row for folder in folders for row in _rows(folder, rounds, threads)]
    note = (
        f"threads: {threads}; {rounds} requests; p50 by the wall's clock, cpu: the least time that "
        "processors spent on it; denoise is one step"
    )
    return ResultTable("Stages of a truncated diffusion, ms", rows, note)


def _rows(folder: Path, rounds: int, threads: int) -> list[dict[str, Any]]:
    bundle = load_bundle(folder)
    card, spec = bundle.card, bundle.card.sampler
    if not isinstance(spec, TruncatedDiffusionSpec):
        raise BenchmarkError(f"{card.name}: expected a truncated_diffusion, got {spec.kind!r}")
    engine = Engine(bundle, threads=threads)
    assert isinstance(engine.sampler, TruncatedDiffusionSampler)
    plain, rows = dict(engine.sampler.graphs), []
    size = sum(path.stat().st_size for path in folder.iterdir()) / 1e6
    for steps in spec.choices:
        times = StageTimes()
        for role, graph in plain.items():
            timed: Any = TimedGraph(graph, role, times)
            engine.sampler.graphs[role] = timed
        request = AnchorRequest.build(
            inputs=_random_inputs(bundle.manifest.request.inputs),
            seed=SEED,
            sampler={"schedule": {"uniform": steps}},
        )
        resolved = resolve_for_card(request, card)
        totals = [engine.plan(resolved).timing_ms["total"] for _ in range(rounds)]
        row = {"model": card.name, "MB": size, "candidates": spec.candidates, "steps": steps}
        for role in ROLES:
            row[f"{role} p50"] = float(np.median(times.wall[role]))
            row[f"{role} cpu"] = min(times.processor[role])
        rows.append(row | {"total p50": float(np.median(totals))})
    return rows


def _random_inputs(specs: Any) -> Inputs:
    rng = np.random.default_rng(SEED)
    inputs = {}
    for spec in specs:
        shape = spec.shape[1:]
        if spec.dtype == "uint8":
            inputs[spec.name] = rng.integers(0, 256, shape, dtype=np.uint8)
        else:
            inputs[spec.name] = rng.random(shape).astype(spec.dtype)
    return inputs
