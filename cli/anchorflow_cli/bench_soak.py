"""`anchorflow bench soak`: a server's memory and descriptors over many requests."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.load import over_http
from anchorflow_benchmarks.machine import circumstances
from anchorflow_benchmarks.planners import limits_of, request_of
from anchorflow_benchmarks.report import Report
from anchorflow_benchmarks.samplers import CARD, parse_sampler
from anchorflow_benchmarks.scene_files import load_scenes
from anchorflow_benchmarks.serving.served import served
from anchorflow_benchmarks.soak import SoakConfig, soak_table
from anchorflow_cli.bench_output import say, show_and_write
from anchorflow_client import JsonCodec
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle


def soak(
    *,
    bundle: Annotated[Path, typer.Option(help="Folder of the bundle.")] = DEFAULT_BUNDLE,
    num: Annotated[int, typer.Option(min=1, max=512, help="Anchors a request.")] = 64,
    sampler: Annotated[str, typer.Option(help="card, midpoint:uniform2, …")] = CARD,
    requests: Annotated[int, typer.Option(min=10, help="In all, or fewer.")] = 10_000,
    seconds: Annotated[float, typer.Option(min=1.0, help="In all, or less.")] = 3600.0,
    scenes: Annotated[
        str, typer.Option(metavar="FILE|drawn:N:SEED", help="Scenes: a .npz file, or drawn ones.")
    ] = "drawn:8:0",
    out: Annotated[Path, typer.Option(help="Folder that the results are written to.")] = Path(
        "benchmarks/results"
    ),
) -> None:
    """Ask a server of its own process again and again, and read what it holds."""
    opened = load_bundle(bundle)
    spec = parse_sampler(sampler, opened.card)
    found = load_scenes(scenes, limits=limits_of(opened))
    asked = [request_of(scene, num=num, seed=1, sampler=spec) for scene in found]
    config = SoakConfig(requests=requests, seconds=seconds)
    with served("--bundle", str(bundle)) as server:
        done = 0

        def tell(count: int) -> None:
            nonlocal done
            done += count
            say(f"{done} of {requests} requests")

        table = soak_table(
            over_http(server.url, JsonCodec()), server.pid, asked, config, progress=tell
        )
    about = {"bundle": opened.card.name, "anchors a request": str(num), "scenes": scenes}
    show_and_write(Report("soak", "Soak", about | circumstances(), [table]), out)
