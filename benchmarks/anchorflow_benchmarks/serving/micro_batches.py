"""Throughput with micro-batches over that without, by turns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from anchorflow_benchmarks.clients import Outcomes
from anchorflow_benchmarks.programs import Served, served
from anchorflow_benchmarks.report import ResultTable, Row, tally
from anchorflow_benchmarks.serving.crowd import CrowdConfig, crowd
from anchorflow_benchmarks.turns import p50, p99
from anchorflow_client.contract import AnchorRequest

WAYS: Mapping[str, tuple[str, ...]] = {
    "one after the other": ("--max-batch", "1"),
    "micro-batches": (),
}


@dataclass
class Rounds:
    """What the rounds of one way gave."""

    outcomes: Outcomes = field(default_factory=Outcomes)
    per_second: list[float] = field(default_factory=list)
    health_ms: list[float] = field(default_factory=list)
    cpu_s: float = 0.0

    def row(self, way: str, budget_ms: float | None) -> Row:
        outcomes = self.outcomes
        return {
            "way": way,
            "budget ms": budget_ms,
            "answers": len(outcomes.ms),
            "per second": p50(self.per_second),
            "p50 ms": outcomes.p50_ms,
            "p99 ms": outcomes.p99_ms,
            "late": None if budget_ms is None else outcomes.late(budget_ms),
            "refused": tally(outcomes.errors),
            "health p99 ms": p99(self.health_ms),
            "CPU ms": self.cpu_s * 1e3 / max(1, len(outcomes.ms)),
        }


def batching_table(
    bundle: Path,
    requests: Sequence[AnchorRequest],
    configs: Sequence[CrowdConfig],
    *,
    rounds: int,
    progress: Callable[[str], None] = lambda _: None,
) -> ResultTable:
    """A row for each way and budget; the ratio of the medians of throughput in the note."""
    rows: list[Row] = []
    ratios: list[str] = []
    with ExitStack() as stack:
        servers = {
            way: stack.enter_context(served("--bundle", str(bundle), *options))
            for way, options in WAYS.items()
        }
        for config in configs:
            results = _by_turns(servers, requests, config, rounds, progress)
            rows += [each.row(way, config.budget_ms) for way, each in results.items()]
            one, other = (p50(each.per_second) for each in results.values())
            ratios.append(f"{other / one:.2f}" if one else "no answers")
    note = (
        f"{configs[0].clients} clients, which encode ahead and read of an answer only who gave it, "
        f"rounds of {configs[0].seconds:g} s by turns; "
        f"throughput with micro-batches over that without: {', '.join(ratios)}"
    )
    return ResultTable("Micro-batches", rows, note)


def _by_turns(
    servers: Mapping[str, Served],
    requests: Sequence[AnchorRequest],
    config: CrowdConfig,
    rounds: int,
    progress: Callable[[str], None],
) -> dict[str, Rounds]:
    results = {way: Rounds() for way in servers}
    for turn in range(rounds):
        for way, server in servers.items():
            progress(f"budget {config.budget_ms} ms, {way}, round {turn + 1} of {rounds}")
            result, before = results[way], server.cpu_s
            outcomes, health_ms = crowd(server.url, requests, config)
            result.cpu_s += server.cpu_s - before
            result.outcomes += outcomes
            result.per_second.append(outcomes.per_second)
            result.health_ms += health_ms
    return results
