"""Load a server or an engine with closed-loop clients, which send a request per answer.

`anchorflow bench load` compares an engine in this process with HTTP in JSON and binary.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from ipaddress import ip_address
from itertools import cycle, islice
from time import perf_counter
from typing import Annotated
from urllib.parse import urlsplit

import typer

from anchorflow_benchmarks import BenchmarkError, options
from anchorflow_benchmarks.planners import CARD, open_bundle, requests_on
from anchorflow_benchmarks.programs import served
from anchorflow_benchmarks.report import ResultTable, Row, report, say, tally
from anchorflow_benchmarks.turns import p50, p99, spare_the_collector
from anchorflow_cli.options import url_option
from anchorflow_client.codec import Codec, JsonCodec
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelId
from anchorflow_client.errors import AnchorFlowError, Overloaded
from anchorflow_client.http import AnchorClient
from anchorflow_client.oip_codec import OipCodec
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http.orjson_codec import OrjsonCodec
from anchorflow_service.local import LocalClient

Ask = Callable[[AnchorRequest], AnchorBatch]
Connect = Callable[[ExitStack], Ask]
"""Opens a client, which the stack closes, and returns its function for requests."""

TIMEOUT_S = 120.0


@dataclass
class Outcomes:
    """Results of the requests of several clients, which share it under its lock."""

    ms: list[float] = field(default_factory=list)
    """Round trip of each answer."""
    errors: Counter[str] = field(default_factory=Counter)
    """Counts by error code, or by class of the exception."""
    models: Counter[ModelId] = field(default_factory=Counter)
    """Counts of answers by model."""
    elapsed_s: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def ask(self, ask: Ask, request: AnchorRequest) -> AnchorBatch:
        """Send a request and record the result; errors are raised again."""
        start = perf_counter()
        try:
            answer = ask(request)
        except AnchorFlowError as error:
            with self.lock:
                self.errors[getattr(error, "code", type(error).__name__)] += 1
            raise
        ms = (perf_counter() - start) * 1e3
        with self.lock:
            self.ms.append(ms)
            self.models[answer.model] += 1
        return answer

    @property
    def failed(self) -> int:
        return self.errors.total()

    def row(self) -> Row:
        return {
            "requests": len(self.ms),
            "per second": len(self.ms) / self.elapsed_s,
            "p50 ms": p50(self.ms) if self.ms else None,
            "p99 ms": p99(self.ms) if self.ms else None,
            "errors": self.failed,
            "error codes": tally(self.errors),
        }


@dataclass(frozen=True)
class LoadConfig:
    """A level ends after `seconds` or `requests`, whichever comes first."""

    clients: Sequence[int] = (1, 4, 16, 64)
    seconds: float = 10.0
    requests: int = 2000


def over_http(url: str, codec: Codec | None = None) -> Connect:
    """Return clients of a server on this machine, each with its own keep-alive connection.

    Raises `BenchmarkError` if the URL names another machine.
    """
    check_loopback(url)
    return lambda stack: (
        stack.enter_context(AnchorClient(url, timeout_s=TIMEOUT_S, codec=codec)).plan_request
    )


@contextmanager
def asking(
    connect: Connect,
    requests: Sequence[AnchorRequest],
    *,
    callers: int,
    seconds: float,
    questions: int | None = None,
) -> Iterator[Outcomes]:
    """Run closed-loop clients, each in a thread, beside the block.

    They stop after `seconds` or after `questions` requests in all, or at once if the block raises;
    then the outcomes are complete. After Retry-After a client pauses for that time.
    """
    outcomes, stopped, left = Outcomes(), threading.Event(), iter(range(questions or 2**63))

    def goes_on() -> bool:
        with outcomes.lock:
            return not stopped.is_set() and perf_counter() < until and next(left, None) is not None

    def ask_on(ask: Ask, first: int) -> None:
        for request in islice(cycle(requests), first % len(requests), None):
            if not goes_on():
                return
            try:
                outcomes.ask(ask, request)
            except Overloaded as error:
                stopped.wait(max(0.0, min(error.retry_after_s or 0.0, until - perf_counter())))
            except AnchorFlowError:
                continue  # it is counted

    with ExitStack() as stack:
        asks = [connect(stack) for _ in range(callers)]
        start = perf_counter()
        until = start + seconds
        threads = [threading.Thread(target=ask_on, args=(ask, k)) for k, ask in enumerate(asks)]
        for thread in threads:
            thread.start()
        try:
            yield outcomes
        except BaseException:
            stopped.set()
            raise
        finally:
            for thread in threads:
                thread.join()
            outcomes.elapsed_s = perf_counter() - start


def check_loopback(url: str) -> None:
    """Raise `BenchmarkError` if the URL names another machine."""
    host = urlsplit(url).hostname or ""
    with suppress(ValueError):
        if host == "localhost" or ip_address(host).is_loopback:
            return
    raise BenchmarkError(
        f"expected a URL of this machine, such as http://127.0.0.1:8000, got {url}"
    )


def load_table(
    ways: dict[str, Connect],
    requests: Sequence[AnchorRequest],
    config: LoadConfig,
    progress: Callable[[str], None] = lambda _: None,
) -> ResultTable:
    """Return throughput, latency and errors of each way at each number of clients."""
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
    """Run `clients` closed-loop clients until the level ends, after a warm-up request."""
    with ExitStack() as stack:
        connect(stack)(requests[0])
    with (
        spare_the_collector(),
        asking(
            connect, requests, callers=clients, seconds=config.seconds, questions=config.requests
        ) as outcomes,
    ):
        pass
    return outcomes.row()


def load(
    *,
    url: Annotated[
        str | None, url_option("A server on this machine.", show_default="one is started")
    ] = None,
    bundle: options.Bundle = DEFAULT_BUNDLE,
    clients: Annotated[str, typer.Option(metavar="N,N", help="Clients.")] = "1,4,16,64",
    num: options.Num = 64,
    sampler: options.Sampler = CARD,
    scenes: options.Scenes = "drawn:8:0",
    seconds: Annotated[float, typer.Option(min=0.1, max=600, help="Of each level.")] = 10.0,
    requests: Annotated[int, typer.Option(min=1, max=100_000, help="Of each level.")] = 2000,
    out: options.Out = options.RESULTS,
) -> None:
    """Load a server on this machine, and the engine in this process, with closed-loop clients."""
    opened = open_bundle(bundle)
    config = LoadConfig(options.whole_numbers(clients, "--clients"), seconds, requests)
    asked = requests_on(opened, scenes, num=num, sampler=sampler)
    with _server(opened, url) as address:
        engine = Engine(opened)
        ways: dict[str, Connect] = {
            "in-process": lambda _: LocalClient(engine).plan_request,
            "HTTP JSON": over_http(address, OrjsonCodec()),
            "HTTP JSON, standard library": over_http(address, JsonCodec()),
            "HTTP binary": over_http(address, OipCodec()),
        }
        table = load_table(ways, asked, config, progress=say)
    about = {"scenes": scenes, "anchors a request": str(num), "server": url or opened.card.name}
    report("Load", about, [table], out)


@contextmanager
def _server(bundle: Bundle, url: str | None) -> Iterator[str]:
    """Yield the URL after checking its model, or that of a server started for the bundle."""
    if url is not None:
        check_loopback(url)
        served_model, own = options.first_card(url).id, bundle.card.id
        if served_model != own:
            raise BenchmarkError(
                f"{url}: expected a server of {own.name} {own.version}, the bundle that is asked "
                f"in this process, got {served_model.name} {served_model.version}"
            )
        yield url
        return
    with served("--bundle", str(bundle.path)) as server:
        yield server
