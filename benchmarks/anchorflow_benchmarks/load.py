"""Load: closed-loop clients, each of which asks again as soon as it has its answer."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from ipaddress import ip_address
from time import perf_counter
from urllib.parse import urlsplit

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.turns import p50, p99, spare_the_collector
from anchorflow_client.codec import Codec
from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.errors import AnchorFlowError
from anchorflow_client.http import AnchorClient
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient

Ask = Callable[[AnchorRequest], AnchorBatch]
Connect = Callable[[ExitStack], Ask]
"""Opens what one client needs, to be closed by the stack, and gives its way to ask."""


@dataclass(frozen=True)
class LoadConfig:
    """A level ends after `seconds` or `requests`, whichever comes first."""

    clients: Sequence[int] = (1, 4, 16, 64)
    seconds: float = 10.0
    requests: int = 2000


@dataclass
class Tally:
    """What the clients of a level saw; they share it under its lock."""

    left: int
    ms: list[float] = field(default_factory=list)
    errors: Counter[str] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def take(self) -> bool:
        """Whether there is a request left to send."""
        with self.lock:
            self.left -= 1
            return self.left >= 0

    def note(self, ms: float, error: AnchorFlowError | None) -> None:
        with self.lock:
            if error is None:
                self.ms.append(ms)
            else:
                self.errors[getattr(error, "code", type(error).__name__)] += 1


def over_http(url: str, codec: Codec) -> Connect:
    """Clients of a server on this machine, each with a connection that is kept alive.

    Args:
        url: of the server.
        codec: the form of what is sent and answered.

    Raises:
        BenchmarkError: the URL names another machine, which is nobody's to load.
    """
    host = urlsplit(url).hostname or ""
    if not _is_loopback(host):
        raise BenchmarkError(f"expected a URL of this machine, such as 127.0.0.1, got {url}")

    def connect(stack: ExitStack) -> Ask:
        return stack.enter_context(AnchorClient(url, timeout_s=120.0, codec=codec)).plan_request

    return connect


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
    tally = Tally(left=config.requests)
    spare_the_collector()
    with ExitStack() as stack:
        asks = [connect(stack) for _ in range(clients)]
        asks[0](requests[0])  # connection and caches, not counted
        start = perf_counter()
        until = start + config.seconds
        threads = [
            threading.Thread(target=_client, args=(ask, requests, offset, until, tally))
            for offset, ask in enumerate(asks)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        elapsed = perf_counter() - start
    return _row(tally, elapsed)


def _client(
    ask: Ask, requests: Sequence[AnchorRequest], offset: int, until: float, tally: Tally
) -> None:
    turn = offset
    while perf_counter() < until and tally.take():
        start, failed = perf_counter(), None
        try:
            ask(requests[turn % len(requests)])
        except AnchorFlowError as error:
            failed = error
        tally.note((perf_counter() - start) * 1e3, failed)
        turn += 1


def _row(tally: Tally, elapsed_s: float) -> Row:
    times = tally.ms
    return {
        "requests": len(times),
        "per second": len(times) / elapsed_s,
        "p50 ms": p50(times) if times else None,
        "p99 ms": p99(times) if times else None,
        "errors": sum(tally.errors.values()),
        "error codes": ", ".join(f"{code} {n}" for code, n in tally.errors.items()) or "none",
    }


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
