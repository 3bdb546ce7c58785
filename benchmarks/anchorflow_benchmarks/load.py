"""Load: closed-loop clients, each of which asks again as soon as it has its answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from anchorflow_benchmarks.clients import Connect, asking
from anchorflow_benchmarks.report import ResultTable, Row, tally
from anchorflow_benchmarks.turns import spare_the_collector
from anchorflow_client.contract import AnchorRequest
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient


@dataclass(frozen=True)
class LoadConfig:
    """A level ends after `seconds` or `requests`, whichever comes first."""

    clients: Sequence[int] = (1, 4, 16, 64)
    seconds: float = 10.0
    requests: int = 2000


def in_process(engine: Engine) -> Connect:
    """Clients that call one engine, which lets them in side by side."""
    return lambda _: LocalClient(engine).plan_request


def load_table(
    ways: dict[str, Connect],
    requests: Sequence[AnchorRequest],
    config: LoadConfig,
    progress: Callable[[str], None] = lambda _: None,
) -> ResultTable:
    """Throughput, latency and errors of each way at each number of clients."""
    rows = []
    for count in config.clients:
        for way, connect in ways.items():
            progress(f"{way}, {count} clients")
            rows.append(
                {"way": way, "clients": count, **run_level(connect, count, requests, config)}
            )
    note = f"closed loop, up to {config.seconds:g} s or {config.requests} requests a level"
    return ResultTable("Load", rows, note)


def run_level(
    connect: Connect, clients: int, requests: Sequence[AnchorRequest], config: LoadConfig
) -> Row:
    """`clients` threads, each asking in turn for the requests, until the level ends."""
    with ExitStack() as stack:
        connect(stack)(requests[0])  # caches, not counted
    with (
        spare_the_collector(),
        asking(
            connect, requests, callers=clients, seconds=config.seconds, questions=config.requests
        ) as outcomes,
    ):
        pass
    return {
        "requests": len(outcomes.ms),
        "per second": outcomes.per_second,
        "p50 ms": outcomes.p50_ms,
        "p99 ms": outcomes.p99_ms,
        "errors": outcomes.failed,
        "error codes": tally(outcomes.errors),
    }
