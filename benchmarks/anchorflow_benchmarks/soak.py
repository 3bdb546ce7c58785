"""Soak: does a server that has answered for a long while still hold what it held at first?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import cycle, islice, pairwise
from time import perf_counter

from anchorflow_benchmarks.clients import Connect, Outcomes
from anchorflow_benchmarks.linux_processes import Held
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_client.contract import AnchorRequest


@dataclass(frozen=True)
class SoakConfig:
    """A soak ends after `requests` or `seconds`, whichever comes first.

    warm_up: requests before the first reading, while arenas and caches fill
    readings: how often memory and descriptors are read
    """

    requests: int = 10_000
    seconds: float = 3600.0
    warm_up: int = 500
    readings: int = 10


def soak_table(
    connect: Connect,
    pid: int,
    requests: Sequence[AnchorRequest],
    config: SoakConfig,
    progress: Callable[[int], None] = lambda _: None,
) -> ResultTable:
    """Memory and descriptors of the server `pid`, again and again while one client asks.

    `progress` gets the number of requests so far.

    Raises:
        AnchorFlowError: a request failed.
        BenchmarkError: the process cannot be read.
    """
    rows: list[Row] = []
    ahead = cycle(requests)
    with ExitStack() as stack:
        ask = connect(stack)
        for request in islice(ahead, config.warm_up):
            ask(request)
        first, until, done = Held.by(pid), perf_counter() + config.seconds, 0
        rows.append({"requests": 0, "memory MB": first.memory_mb, "descriptors": first.descriptors})
        marks = [config.requests * k // config.readings for k in range(config.readings + 1)]
        for before, after in pairwise(marks):
            outcomes = Outcomes()
            for request in islice(ahead, after - before):
                outcomes.ask(ask, request)
                if perf_counter() > until:
                    break
            done += len(outcomes.ms)
            progress(done)
            rows.append(_reading(done, Held.by(pid), first, outcomes))
            if perf_counter() > until:
                break
    note = f"one client, after {config.warm_up} requests to warm up"
    return ResultTable("Soak", rows, note)


def _reading(done: int, held: Held, first: Held, outcomes: Outcomes) -> Row:
    return {
        "requests": done,
        "memory MB": held.memory_mb,
        "grown by MB": held.memory_mb - first.memory_mb,
        "descriptors": held.descriptors,
        "p50 ms": outcomes.p50_ms,
        "p99 ms": outcomes.p99_ms,
    }
