"""`anchorflow bench load`, `serving`, `release`, `swaps`, `kill` and `soak`: a server's callers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from anchorflow_benchmarks.clients import check_loopback, over_http
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_benchmarks.load import LoadConfig, in_process, load_table
from anchorflow_benchmarks.programs import served
from anchorflow_benchmarks.samplers import CARD
from anchorflow_benchmarks.serving.crowd import CrowdConfig
from anchorflow_benchmarks.serving.kills import KillConfig, kill_table
from anchorflow_benchmarks.serving.micro_batches import batching_table
from anchorflow_benchmarks.serving.release import release_table
from anchorflow_benchmarks.serving.swaps import swap_table
from anchorflow_benchmarks.soak import SoakConfig, soak_table
from anchorflow_cli.bench_options import (
    RESULTS,
    STUDENT,
    BundleOption,
    ClientsOption,
    NumOption,
    OutOption,
    SamplerOption,
    ScenesOption,
    first_card,
    requests_on,
    whole_numbers,
)
from anchorflow_cli.bench_output import report, say
from anchorflow_cli.options import url_option
from anchorflow_client.contract.checks import number
from anchorflow_client.contract.ranges import BUDGET
from anchorflow_client.json_codec import JsonCodec
from anchorflow_client.oip_codec import OipCodec
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http.orjson_codec import OrjsonCodec


def load(
    *,
    url: Annotated[
        str | None, url_option("A server on this machine.", show_default="one is started")
    ] = None,
    bundle: BundleOption = DEFAULT_BUNDLE,
    clients: Annotated[str, typer.Option(metavar="N,N", help="Clients.")] = "1,4,16,64",
    num: NumOption = 64,
    sampler: SamplerOption = CARD,
    scenes: ScenesOption = "drawn:8:0",
    seconds: Annotated[float, typer.Option(min=0.1, max=600, help="Of each level.")] = 10.0,
    requests: Annotated[int, typer.Option(min=1, max=100_000, help="Of each level.")] = 2000,
    out: OutOption = RESULTS,
) -> None:
    """Load a server on this machine, and the engine in this process, with closed-loop clients."""
    opened = open_bundle(bundle)
    config = LoadConfig(whole_numbers(clients, "--clients"), seconds, requests)
    asked = requests_on(opened, scenes, num=num, sampler=sampler)
    with _server(opened, url) as address:
        ways = {
            "in-process": in_process(Engine(opened)),
            "HTTP JSON": over_http(address, OrjsonCodec()),
            "HTTP JSON, standard library": over_http(address, JsonCodec()),
            "HTTP binary": over_http(address, OipCodec()),
        }
        table = load_table(ways, asked, config, progress=say)
    about = {"scenes": scenes, "anchors a request": str(num), "server": url or opened.card.name}
    report("Load", about, [table], out)


@contextmanager
def _server(bundle: Bundle, url: str | None) -> Iterator[str]:
    """The URL given, or that of a server of the bundle in a process of its own."""
    if url is not None:
        check_loopback(url)
        served_model, own = first_card(url).id, bundle.card.id
        if served_model != own:
            raise BenchmarkError(
                f"{url}: expected a server of {own.name} {own.version}, the bundle that is asked "
                f"in this process, got {served_model.name} {served_model.version}"
            )
        yield url
        return
    with served("--bundle", str(bundle.path)) as server:
        yield server.url


def serving(
    *,
    bundle: BundleOption = DEFAULT_BUNDLE,
    num: NumOption = 16,
    sampler: SamplerOption = CARD,
    scenes: ScenesOption = "drawn:8:0",
    clients: ClientsOption = 64,
    seconds: Annotated[float, typer.Option(min=0.1, help="Of each round.")] = 20.0,
    rounds: Annotated[int, typer.Option(min=1, help="Of each way.")] = 3,
    budgets: Annotated[
        list[float] | None,
        typer.Option("--budget-ms", help="Of every request; repeatable.", show_default="none"),
    ] = None,
    out: OutOption = RESULTS,
) -> None:
    """Throughput, latency and health of a server with micro-batches and without, by turns."""
    opened = open_bundle(bundle)
    asked = [number(budget, "--budget-ms", BUDGET) for budget in budgets or []]
    configs = [CrowdConfig(clients, seconds, budget) for budget in asked or [None]]
    requests = requests_on(opened, scenes, num=num, sampler=sampler)
    table = batching_table(bundle, requests, configs, rounds=rounds, progress=say)
    report("Serving", _about(opened, num, sampler) | {"scenes": scenes}, [table], out)


def release(
    *,
    bundle: BundleOption = DEFAULT_BUNDLE,
    num: NumOption = 64,
    sampler: SamplerOption = "rk4:uniform8",
    rounds: Annotated[int, typer.Option(min=1, help="Requests given up in each way.")] = 30,
    out: OutOption = RESULTS,
) -> None:
    """Time until an engine is free after a caller has gone, over that of a solver step."""
    opened = open_bundle(bundle)
    (request,) = requests_on(opened, "drawn:1:0", num=num, sampler=sampler)
    table = release_table(Engine(opened, threads=1), request, rounds=rounds)
    report("Release", _about(opened, num, sampler), [table], out)


def swaps(
    *,
    bundle: BundleOption = DEFAULT_BUNDLE,
    num: NumOption = 16,
    sampler: SamplerOption = "midpoint:uniform2",
    clients: ClientsOption = 16,
    seconds: Annotated[float, typer.Option(min=0.1, help="That the clients ask.")] = 60.0,
    count: Annotated[int, typer.Option("--swaps", min=1, help="Swaps meanwhile.")] = 20,
    out: OutOption = RESULTS,
) -> None:
    """Swap a bundle while clients ask, and count the requests that fail."""
    opened = open_bundle(bundle)
    requests = requests_on(opened, "drawn:8:0", num=num, sampler=sampler)
    config = CrowdConfig(clients, seconds)
    with TemporaryDirectory() as folder:
        table = swap_table(bundle, requests, config, swaps=count, folder=Path(folder), progress=say)
    report("Swaps", _about(opened, num, sampler), [table], out)


def kill(
    *,
    bundle: BundleOption = STUDENT,
    num: NumOption = 16,
    sampler: SamplerOption = CARD,
    clients: ClientsOption = 4,
    seconds: Annotated[float, typer.Option(min=1.0, help="That the clients ask.")] = 30.0,
    count: Annotated[int, typer.Option("--kills", min=1, help="Kills meanwhile.")] = 2,
    out: OutOption = RESULTS,
) -> None:
    """Kill workers, and Ray's replicas where it is there, and count the requests that fail."""
    opened = open_bundle(bundle)
    requests = requests_on(opened, "drawn:8:0", num=num, sampler=sampler)
    config = KillConfig(clients=clients, seconds=seconds, kills=count)
    table = kill_table(bundle, requests, config, progress=say)
    report("Kills", _about(opened, num, sampler), [table], out)


def soak(
    *,
    bundle: BundleOption = DEFAULT_BUNDLE,
    num: NumOption = 64,
    sampler: SamplerOption = CARD,
    requests: Annotated[int, typer.Option(min=10, help="In all, or fewer.")] = 10_000,
    seconds: Annotated[float, typer.Option(min=1.0, help="In all, or less.")] = 3600.0,
    scenes: ScenesOption = "drawn:8:0",
    out: OutOption = RESULTS,
) -> None:
    """Ask a server of its own process again and again, and read what it holds."""
    opened = open_bundle(bundle)
    asked = requests_on(opened, scenes, num=num, sampler=sampler)
    config = SoakConfig(requests=requests, seconds=seconds)
    with served("--bundle", str(bundle)) as server:
        connect = over_http(server.url, JsonCodec())
        table = soak_table(
            connect,
            server.pid,
            asked,
            config,
            progress=lambda done: say(f"{done} of {requests} requests"),
        )
    about = {"bundle": opened.card.name, "anchors a request": str(num), "scenes": scenes}
    report("Soak", about, [table], out)


def _about(opened: Bundle, num: int, sampler: str) -> dict[str, str]:
    model = f"{opened.card.name} {opened.card.version}"
    return {"model": model, "anchors a request": str(num), "sampler": sampler}
