"""`anchorflow bench zenoh` and `failover`: what zenoh costs, and what it survives."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.clients import Ask, over_http
from anchorflow_benchmarks.failover import FailoverConfig
from anchorflow_benchmarks.failover import failover as run_failover
from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_benchmarks.programs import (
    Program,
    free_endpoint,
    router_command,
    running,
    serve_command,
    served,
)
from anchorflow_benchmarks.samplers import CARD
from anchorflow_benchmarks.transports import IN_PROCESS, transport_table
from anchorflow_cli.bench_options import (
    RESULTS,
    BundleOption,
    NumOption,
    OutOption,
    SamplerOption,
    ScenesOption,
    requests_on,
)
from anchorflow_cli.bench_output import report, say
from anchorflow_cli.extras import needs_extra
from anchorflow_client.base_client import BaseClient
from anchorflow_client.json_codec import JsonCodec
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http.orjson_codec import OrjsonCodec
from anchorflow_service.local import LocalClient


def zenoh(
    *,
    bundle: BundleOption = DEFAULT_BUNDLE,
    num: NumOption = 64,
    sampler: SamplerOption = CARD,
    scenes: ScenesOption = "drawn:4:0",
    rounds: Annotated[int, typer.Option(min=3, help="Times that each way is taken.")] = 100,
    budget_s: Annotated[float, typer.Option(help="Seconds after which a way rests.")] = 60.0,
    out: OutOption = RESULTS,
) -> None:
    """Time a request in this process, over HTTP in each form, over zenoh directly and routed."""
    opened = open_bundle(bundle)
    requests = requests_on(opened, scenes, num=num, sampler=sampler)
    with ExitStack() as stack:
        ways = _ways(opened, bundle, stack)
        table = transport_table(ways, requests, rounds=rounds, budget_s=budget_s)
    about = {"model": f"{opened.card.name} {opened.card.version}", "scenes": scenes}
    about |= {"anchors a request": str(num), "sampler": sampler}
    report("Zenoh", about, [table], out)


def failover(
    *,
    bundle: BundleOption = DEFAULT_BUNDLE,
    num: NumOption = 16,
    sampler: SamplerOption = "midpoint:uniform2",
    hz: Annotated[float, typer.Option(min=0.1, max=1000, help="Requests a second.")] = 20.0,
    seconds: Annotated[float, typer.Option(min=1, max=3600, help="Of the whole run.")] = 60.0,
    out: OutOption = RESULTS,
) -> None:
    """Kill one of two services behind a router while a client asks, and start it again."""
    opened = open_bundle(bundle)
    (request,) = requests_on(opened, "drawn:1:0", num=num, sampler=sampler)
    config = FailoverConfig(hz=hz, seconds=seconds)
    endpoint = free_endpoint()
    serve = ("--bundle", str(bundle), "--zenoh", "client", "--zenoh-connect", endpoint)
    with ExitStack() as stack:
        stack.enter_context(running(Program("router", router_command(endpoint))))
        replicas = [
            stack.enter_context(
                running(Program(name, serve_command(*serve, "--zenoh-replica", name)))
            )
            for name in ("a", "b")
        ]
        client = stack.enter_context(_client(endpoint))
        outcome = run_failover(client, replicas, request, config, progress=say)
    about = {"anchors a request": str(num), "sampler": sampler}
    report("Failover", about, outcome.tables(config), out)


def _ways(opened: Bundle, bundle: Path, stack: ExitStack) -> dict[str, Ask]:
    """The engine here, and a service in a process of its own by three ways."""
    router, direct = free_endpoint(), free_endpoint()
    stack.enter_context(running(Program("router", router_command(router))))
    options = ("--zenoh", "peer", "--zenoh-connect", router, "--zenoh-listen", direct)
    url = stack.enter_context(served("--bundle", str(bundle), *options)).url
    return {
        IN_PROCESS: LocalClient(Engine(opened)).plan_request,
        "HTTP binary": over_http(url)(stack),
        "HTTP JSON": over_http(url, OrjsonCodec())(stack),
        "HTTP JSON, standard library": over_http(url, JsonCodec())(stack),
        "zenoh": stack.enter_context(_client(direct)).plan_request,
        "zenoh by a router": stack.enter_context(_client(router)).plan_request,
    }


def _client(endpoint: str) -> BaseClient:
    with needs_extra("zenoh", who="anchorflow bench zenoh"):
        from anchorflow_client.zenoh_client import ZenohAnchorClient
    return ZenohAnchorClient(endpoint, timeout_s=20.0)
