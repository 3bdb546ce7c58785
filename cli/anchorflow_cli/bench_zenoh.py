"""`anchorflow bench zenoh` and `failover`: what zenoh costs, and what it survives."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.failover import FailoverConfig
from anchorflow_benchmarks.failover import failover as run_failover
from anchorflow_benchmarks.machine import circumstances
from anchorflow_benchmarks.planners import limits_of, request_of
from anchorflow_benchmarks.report import Report
from anchorflow_benchmarks.samplers import CARD, parse_sampler
from anchorflow_benchmarks.scene_files import load_scenes
from anchorflow_benchmarks.transports import IN_PROCESS, Ask, transport_table
from anchorflow_benchmarks.zenoh_processes import (
    Process,
    free_endpoint,
    router_command,
    running,
    serve_command,
)
from anchorflow_cli.bench_output import say, show_and_write
from anchorflow_cli.extras import needs_extra
from anchorflow_client.base_client import BaseClient
from anchorflow_client.http import AnchorClient
from anchorflow_client.json_codec import JsonCodec
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http.orjson_codec import OrjsonCodec
from anchorflow_service.local import LocalClient

BundleOption = Annotated[Path, typer.Option(help="Folder of the bundle.")]
ScenesOption = Annotated[
    str, typer.Option(metavar="FILE|drawn:N:SEED", help="Scenes: a .npz file, or drawn ones.")
]
NumOption = Annotated[int, typer.Option(min=1, max=512, help="Anchors a request.")]
SamplerOption = Annotated[str, typer.Option(help="card, rk4:8step, midpoint:uniform2, …")]
OutOption = Annotated[Path, typer.Option(help="Folder that the results are written to.")]
RESULTS = Path("benchmarks/results")


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
    opened = load_bundle(bundle)
    spec = parse_sampler(sampler, opened.card)
    found = load_scenes(scenes, limits=limits_of(opened))
    requests = [request_of(scene, num=num, seed=1, sampler=spec) for scene in found]
    with ExitStack() as stack:
        ways = _ways(opened, bundle, stack)
        table = transport_table(ways, requests, rounds=rounds, budget_s=budget_s)
    about = {"scenes": scenes, "anchors a request": str(num), "sampler": sampler}
    show_and_write(Report("zenoh", "Zenoh", about | circumstances(), [table]), out)


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
    opened = load_bundle(bundle)
    spec = parse_sampler(sampler, opened.card)
    (scene,) = load_scenes("drawn:1:0", limits=limits_of(opened))
    request = request_of(scene, num=num, seed=1, sampler=spec)
    config = FailoverConfig(hz=hz, seconds=seconds)
    endpoint = free_endpoint()
    at_router = ("--zenoh", "client", "--zenoh-connect", endpoint)
    with ExitStack() as stack:
        stack.enter_context(running(Process("router", router_command(endpoint))))
        replicas = [
            stack.enter_context(
                running(Process(name, serve_command(bundle, *at_router, "--zenoh-replica", name)))
            )
            for name in ("a", "b")
        ]
        client = stack.enter_context(_client(endpoint))
        outcome = run_failover(client, replicas, request, config, progress=say)
    about = {"anchors a request": str(num), "sampler": sampler}
    report = Report("failover", "Failover", about | circumstances(), outcome.tables(config))
    show_and_write(report, out)


def _ways(opened: Bundle, bundle: Path, stack: ExitStack) -> dict[str, Ask]:
    """The engine here, and a service in a process of its own by three ways."""
    router, direct = free_endpoint(), free_endpoint()
    stack.enter_context(running(Process("router", router_command(router))))
    zenoh_options = ("--zenoh", "peer", "--zenoh-connect", router, "--zenoh-listen", direct)
    service = Process("service", serve_command(bundle, *zenoh_options))
    line = service.start()  # NAME VERSION at URL (bundle FOLDER)
    stack.callback(service.kill)
    url = line.partition(" at ")[2].partition(" ")[0]
    binary = stack.enter_context(AnchorClient(url))
    by_orjson = stack.enter_context(AnchorClient(url, codec=OrjsonCodec()))
    by_json = stack.enter_context(AnchorClient(url, codec=JsonCodec()))
    by_router = stack.enter_context(_client(router))
    directly = stack.enter_context(_client(direct))
    return {
        IN_PROCESS: LocalClient(Engine(opened)).plan_request,
        "HTTP binary": binary.plan_request,
        "HTTP JSON": by_orjson.plan_request,
        "HTTP JSON, standard library": by_json.plan_request,
        "zenoh": directly.plan_request,
        "zenoh by a router": by_router.plan_request,
    }


def _client(endpoint: str) -> BaseClient:
    with needs_extra("zenoh", who="anchorflow bench zenoh"):
        from anchorflow_client.zenoh_client import ZenohAnchorClient
    return ZenohAnchorClient(endpoint, timeout_s=20.0)
