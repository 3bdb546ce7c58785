"""`anchorflow bench serving`, `release`, `swaps` and `kill`: a server under many callers."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from anchorflow_benchmarks.machine import circumstances
from anchorflow_benchmarks.planners import limits_of, request_of
from anchorflow_benchmarks.report import Report
from anchorflow_benchmarks.samplers import CARD, parse_sampler
from anchorflow_benchmarks.scene_files import load_scenes
from anchorflow_benchmarks.serving.crowd import CrowdConfig
from anchorflow_benchmarks.serving.kills import KillConfig, kill_table
from anchorflow_benchmarks.serving.micro_batches import batching_table
from anchorflow_benchmarks.serving.release import release_table
from anchorflow_benchmarks.serving.swaps import swap_table
from anchorflow_cli.bench_output import say, show_and_write
from anchorflow_client.contract import AnchorRequest
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_service.engine import Engine

BundleOption = Annotated[Path, typer.Option(help="Folder of the bundle.")]
ScenesOption = Annotated[
    str, typer.Option(metavar="FILE|drawn:N:SEED", help="Scenes: a .npz file, or drawn ones.")
]
NumOption = Annotated[int, typer.Option(min=1, max=512, help="Anchors a request.")]
SamplerOption = Annotated[str, typer.Option(help="card, rk4:8step, midpoint:uniform2, …")]
ClientsOption = Annotated[int, typer.Option(min=1, help="Closed-loop clients.")]
OutOption = Annotated[Path, typer.Option(help="Folder that the results are written to.")]
RESULTS = Path("benchmarks/results")
STUDENT = DEFAULT_BUNDLE.parent / "student"


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
    opened = load_bundle(bundle)
    configs = [CrowdConfig(clients, seconds, budget) for budget in budgets or [None]]
    requests = _requests(opened, scenes, num, sampler)
    table = batching_table(bundle, requests, configs, rounds=rounds, progress=say)
    about = _about(opened, num, sampler) | {"scenes": scenes}
    show_and_write(Report("serving", "Serving", about | circumstances(), [table]), out)


def release(
    *,
    bundle: BundleOption = DEFAULT_BUNDLE,
    num: NumOption = 64,
    sampler: SamplerOption = "rk4:uniform8",
    rounds: Annotated[int, typer.Option(min=1, help="Requests given up in each way.")] = 30,
    out: OutOption = RESULTS,
) -> None:
    """Time until an engine is free after a caller has gone, over that of a solver step."""
    opened = load_bundle(bundle)
    (request,) = _requests(opened, "drawn:1:0", num, sampler)
    table = release_table(Engine(opened, threads=1), request, rounds=rounds)
    report = Report("release", "Release", _about(opened, num, sampler) | circumstances(), [table])
    show_and_write(report, out)


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
    opened = load_bundle(bundle)
    requests = _requests(opened, "drawn:8:0", num, sampler)
    config = CrowdConfig(clients, seconds)
    with TemporaryDirectory() as folder:
        table = swap_table(bundle, requests, config, swaps=count, folder=Path(folder), progress=say)
    report = Report("swaps", "Swaps", _about(opened, num, sampler) | circumstances(), [table])
    show_and_write(report, out)


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
    opened = load_bundle(bundle)
    requests = _requests(opened, "drawn:8:0", num, sampler)
    config = KillConfig(clients=clients, seconds=seconds, kills=count)
    table = kill_table(bundle, requests, config, progress=say)
    report = Report("kills", "Kills", _about(opened, num, sampler) | circumstances(), [table])
    show_and_write(report, out)


def _requests(opened: Bundle, scenes: str, num: int, sampler: str) -> list[AnchorRequest]:
    spec = parse_sampler(sampler, opened.card)
    found = load_scenes(scenes, limits=limits_of(opened))
    return [request_of(scene, num=num, seed=1, sampler=spec) for scene in found]


def _about(opened: Bundle, num: int, sampler: str) -> dict[str, str]:
    model = f"{opened.card.name} {opened.card.version}"
    return {"model": model, "anchors a request": str(num), "sampler": sampler}
