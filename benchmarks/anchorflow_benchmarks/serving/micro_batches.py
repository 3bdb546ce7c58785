"""Throughput with micro-batches over that without, by turns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.serving.crowd import CrowdConfig, Seen, crowd
from anchorflow_benchmarks.serving.served import Served, served
from anchorflow_benchmarks.turns import p50, p99
from anchorflow_client.contract import AnchorRequest

WAYS: Mapping[str, tuple[str, ...]] = {
    "one after the other": ("--max-batch", "1"),
    "micro-batches": (),
}


@dataclass
class Rounds:
    """What the rounds of one way gave."""

    per_second: list[float] = field(default_factory=list)
    answered_ms: list[float] = field(default_factory=list)
    health_ms: list[float] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)
    late: int = 0
    cpu_s: float = 0.0

    def add(self, seen: Seen, *, budget_ms: float | None, cpu_s: float) -> None:
        """One more round."""
        self.per_second.append(seen.per_second)
        self.answered_ms += seen.answered_ms
        self.health_ms += seen.health_ms
        self.refused += seen.refused
        self.late += 0 if budget_ms is None else seen.late(budget_ms)
        self.cpu_s += cpu_s

    def row(self, way: str, budget_ms: float | None) -> Row:
        answered = len(self.answered_ms)
        return {
            "way": way,
            "budget ms": budget_ms,
            "answers": answered,
            "per second": p50(self.per_second),
            "p50 ms": p50(self.answered_ms) if answered else None,
            "p99 ms": p99(self.answered_ms) if answered else None,
            "late": None if budget_ms is None else self.late,
            "refused": ", ".join(f"{code} {n}" for code, n in self.refused.items()) or "none",
            "health p99 ms": p99(self.health_ms),
            "CPU ms": self.cpu_s * 1e3 / max(1, answered),
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
        f"{configs[0].clients} clients, rounds of {configs[0].seconds:g} s by turns; "
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
            before = server.cpu_s
            seen = crowd(server.url, requests, config)
            results[way].add(seen, budget_ms=config.budget_ms, cpu_s=server.cpu_s - before)
    return results
