"""Time the same requests in this process, over HTTP and over zenoh: what does a transport add?

Run by `anchorflow bench zenoh`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from itertools import cycle
from time import perf_counter
from typing import Annotated

import typer

from anchorflow_benchmarks import options
from anchorflow_benchmarks.load import Ask, over_http
from anchorflow_benchmarks.planners import CARD, open_bundle, requests_on
from anchorflow_benchmarks.programs import Program, free_endpoint, router_command, running, served
from anchorflow_benchmarks.report import ResultTable, Row, report
from anchorflow_benchmarks.turns import p50, p99, spare_the_collector, take_turns
from anchorflow_cli.extras import needs_extra
from anchorflow_client.base_client import BaseClient
from anchorflow_client.codec import JsonCodec
from anchorflow_client.contract import AnchorRequest
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http.orjson_codec import OrjsonCodec
from anchorflow_service.local import LocalClient

ENGINE_STAGES = ("encode", "sample", "refine")
IN_PROCESS = "in-process"


def transport_table(
    ways: dict[str, Ask],
    requests: Sequence[AnchorRequest],
    *,
    rounds: int,
    budget_s: float,
) -> ResultTable:
    """Return the round trips of each way, and the time that they spend outside the engine.

    ways: functions that send a request, by name; one of them is `IN_PROCESS`
    rounds, budget_s: see `take_turns`
    """
    beside: dict[str, list[float]] = {name: [] for name in ways}
    calls = {name: _timed(ask, requests, beside[name]) for name, ask in ways.items()}
    with spare_the_collector():
        times = take_turns(calls, rounds=rounds, budget_s=budget_s)
    # The first call of each opens connections and is not counted.
    spare = {name: p50(values[1:]) for name, values in beside.items()}
    rows: list[Row] = [
        {
            "way": name,
            "p50 ms": p50(values),
            "p99 ms": p99(values),
            "p50 - in-process p50 ms": p50(values) - p50(times[IN_PROCESS]),
            "beside the engine p50 ms": spare[name],
            "added p50 ms": spare[name] - spare[IN_PROCESS],
            "requests": len(values),
        }
        for name, values in times.items()
    ]
    note = (
        "beside the engine: the round trip without the encode, sample and refine that the answer "
        "tells; added: that, less the same in-process"
    )
    return ResultTable("What a transport adds", rows, note)


def _timed(ask: Ask, requests: Sequence[AnchorRequest], beside: list[float]) -> Callable[[], None]:
    ahead = cycle(requests)

    def call() -> None:
        request = next(ahead)
        start = perf_counter()
        timing_ms = ask(request).timing_ms
        round_trip_ms = (perf_counter() - start) * 1e3
        beside.append(round_trip_ms - sum(timing_ms[stage] for stage in ENGINE_STAGES))

    return call


def zenoh(
    *,
    bundle: options.Bundle = DEFAULT_BUNDLE,
    num: options.Num = 64,
    sampler: options.Sampler = CARD,
    scenes: options.Scenes = "drawn:4:0",
    rounds: Annotated[int, typer.Option(min=3, help="Times that each way is taken.")] = 100,
    budget_s: Annotated[float, typer.Option(help="Seconds after which a way rests.")] = 60.0,
    out: options.Out = options.RESULTS,
) -> None:
    """Time a request in this process, over HTTP in each form, over zenoh directly and routed."""
    opened = open_bundle(bundle)
    requests = requests_on(opened, scenes, num=num, sampler=sampler)
    with ExitStack() as stack:
        ways = _ways(opened, stack)
        table = transport_table(ways, requests, rounds=rounds, budget_s=budget_s)
    about = {"model": f"{opened.card.name} {opened.card.version}", "scenes": scenes}
    about |= {"anchors a request": str(num), "sampler": sampler}
    report("Zenoh", about, [table], out)


def _ways(opened: Bundle, stack: ExitStack) -> dict[str, Ask]:
    """Return the engine in this process, and the ways to a service in another process."""
    router, direct = free_endpoint(), free_endpoint()
    stack.enter_context(running(Program("router", router_command(router))))
    options = ("--zenoh", "peer", "--zenoh-connect", router, "--zenoh-listen", direct)
    url = stack.enter_context(served("--bundle", str(opened.path), *options))
    return {
        IN_PROCESS: LocalClient(Engine(opened)).plan_request,
        "HTTP binary": over_http(url)(stack),
        "HTTP JSON": over_http(url, OrjsonCodec())(stack),
        "HTTP JSON, base64": over_http(url, JsonCodec(base64=True))(stack),
        "HTTP JSON, standard library": over_http(url, JsonCodec())(stack),
        "zenoh": stack.enter_context(_client(direct)).plan_request,
        "zenoh by a router": stack.enter_context(_client(router)).plan_request,
    }


def _client(endpoint: str) -> BaseClient:
    with needs_extra("zenoh", who="anchorflow bench zenoh"):
        from anchorflow_client.zenoh_client import ZenohAnchorClient
    return ZenohAnchorClient(endpoint, timeout_s=20.0)
