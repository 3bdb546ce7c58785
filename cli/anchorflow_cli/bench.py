"""`anchorflow bench ...`: measure the anchors' quality, the engine's latency, a server's load."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.baselines import BASELINES, ExpertPlanner, named_baselines
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.latency import (
    Contest,
    LatencyConfig,
    Loop,
    latency_tables,
    onnx_loop,
    torch_loop,
)
from anchorflow_benchmarks.load import LoadConfig, in_process, load_table, over_http
from anchorflow_benchmarks.machine import circumstances
from anchorflow_benchmarks.planners import (
    Planner,
    bundle_names,
    engine_planners,
    limits_of,
    request_of,
)
from anchorflow_benchmarks.quality import judge_planners, quality_tables, style_table
from anchorflow_benchmarks.report import Report
from anchorflow_benchmarks.samplers import CARD, parse_sampler
from anchorflow_benchmarks.scene_files import default_source, load_scenes
from anchorflow_benchmarks.serving.served import served
from anchorflow_cli import bench_closed_loop, bench_serving, bench_soak, bench_zenoh
from anchorflow_cli.bench_output import progress, say, show_and_write, whole_numbers
from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import command_app
from anchorflow_client.json_codec import JsonCodec
from anchorflow_client.oip_codec import OipCodec
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_service.cores import usable_cores
from anchorflow_service.engine import Engine
from anchorflow_service.http.orjson_codec import OrjsonCodec

app = command_app()

BundlesOption = Annotated[
    list[Path] | None,
    typer.Option("--bundle", help="Folder of a bundle; repeatable.", show_default="that ships"),
]
SCENES = "FILE|drawn:N:SEED"
ScenesOption = Annotated[
    str, typer.Option(metavar=SCENES, help="Scenes: a .npz file, or drawn ones.")
]
SamplersOption = Annotated[
    str, typer.Option(metavar="A,B", help="card, rk4:8step, rk4:uniform8, midpoint:uniform2, …")
]
ThreadsOption = Annotated[
    int | None, typer.Option(min=1, help="Threads of a request.", show_default="the cores")
]
OutOption = Annotated[Path, typer.Option(help="Folder that the results are written to.")]

RESULTS = Path("benchmarks/results")


@app.callback()
def bench() -> None:
    """Measure the anchors' quality, the engine's latency, a server's load."""


@app.command()
def quality(
    *,
    bundle: BundlesOption = None,
    scenes: Annotated[
        str | None,
        typer.Option(
            metavar=SCENES,
            help="Scenes: a .npz file, or drawn ones.",
            show_default="../shared/data/scenes_public.npz, or drawn:60:0 without it",
        ),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Scenes at most.")] = None,
    num: Annotated[int, typer.Option(min=1, max=512, help="Anchors a scene.")] = 64,
    samplers: SamplersOption = CARD,
    baselines: Annotated[
        str, typer.Option(metavar="A,B", help="Of expert, lines, rrt; none for no baselines.")
    ] = ",".join(BASELINES),
    style: Annotated[bool, typer.Option(help="Measure what a change of style changes.")] = True,
    threads: ThreadsOption = None,
    out: OutOption = RESULTS,
) -> None:
    """Judge bundles and baselines on scenes; tables, JSON, Markdown and pictures."""
    with needs_extra("plot", who="anchorflow bench quality"):
        from anchorflow_benchmarks.pictures import draw_quality_over_time, draw_scene_sheet
    bundles = [load_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE]]
    ours: list[Planner] = [*engine_planners(bundles, samplers.split(","), threads=threads)]
    names = [] if baselines == "none" else baselines.split(",")
    with needs_extra("bench", who="anchorflow bench quality --baselines rrt"):
        planners = [*ours, *named_baselines(names, bundles[0])]
    limits, source = limits_of(bundles[0]), scenes or default_source()
    found = load_scenes(source, limits=limits, limit=limit)
    with progress("judging", len(found)) as advance:
        plans = judge_planners(planners, found, limits=limits, num=num, progress=advance)
    tables = quality_tables(planners, plans)
    if style:
        styled = [*ours, *([ExpertPlanner(limits, 60)] if "expert" in names else [])]
        with progress("styles", len(found)) as advance:
            tables.append(style_table(styled, found, limits=limits, num=num, progress=advance))
    about = {"scenes": f"{Path(source).name}, {len(found)} judged", "anchors a scene": str(num)}
    show_and_write(Report("quality", "Quality", about | circumstances(), tables), out)
    draw_scene_sheet(plans[ours[0].name], out / "quality_scenes.png", title=ours[0].name)
    draw_quality_over_time(tables[0].rows, out / "quality_time.png")


@app.command()
def latency(
    *,
    bundle: BundlesOption = None,
    checkpoint: Annotated[
        list[Path] | None,
        typer.Option(help="The bundle's checkpoint, for the torch loop; repeatable, in order."),
    ] = None,
    samplers: SamplersOption = "rk4:8step",
    nums: Annotated[str, typer.Option(metavar="N,N", help="Anchors a request.")] = "1,16,64,256",
    scenes: ScenesOption = "drawn:4:0",
    rounds: Annotated[int, typer.Option(min=3, help="Times that each call is timed.")] = 30,
    budget_s: Annotated[float, typer.Option(help="Seconds after which a slow call rests.")] = 20.0,
    repeat_inputs: Annotated[
        bool, typer.Option("--repeat-inputs", help="Also time ONNX with N encodings a call.")
    ] = False,
    threads: ThreadsOption = None,
    out: OutOption = RESULTS,
) -> None:
    """Time a request in this process against plain loops and the machine's floor."""
    bundles = [load_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE]]
    config = LatencyConfig(
        counts=whole_numbers(nums, "--nums"),
        rounds=rounds,
        budget_s=budget_s,
        threads=threads or usable_cores(),
    )
    weights = [*(checkpoint or []), *[None] * len(bundles)]
    if len(checkpoint or []) > len(bundles):
        raise BenchmarkError("expected at most one --checkpoint for each --bundle")
    contests = [
        Contest(name, one, parse_sampler(text, one.card), loops)
        for one, name, path in zip(bundles, bundle_names(bundles), weights, strict=False)
        for loops in [plain_loops(one, path, config.threads, repeat_inputs=repeat_inputs)]
        for text in samplers.split(",")
    ]
    found = load_scenes(scenes, limits=limits_of(bundles[0]))
    tables = latency_tables(contests, found, config, progress=say)
    about = {"scenes": scenes, "threads": str(config.threads)}
    show_and_write(Report("latency", "Latency", about | circumstances(), tables), out)


def plain_loops(
    bundle: Bundle, checkpoint: Path | None, threads: int, *, repeat_inputs: bool
) -> dict[str, Loop]:
    """What the engine is compared with; torch is loaded where there is a checkpoint."""
    loops = {"ONNX loop": onnx_loop(bundle, threads=threads)}
    if repeat_inputs:
        loops["ONNX loop, inputs repeated"] = onnx_loop(bundle, threads=threads, repeat_inputs=True)
    if checkpoint is not None:
        with needs_extra("train", who="anchorflow bench latency --checkpoint"):
            loops["torch loop"] = torch_loop(checkpoint, threads=threads)
    return loops


@app.command()
def load(
    *,
    url: Annotated[
        str | None, typer.Option(help="A server on this machine.", show_default="one is started")
    ] = None,
    bundle: Annotated[Path, typer.Option(help="Folder of the bundle.")] = DEFAULT_BUNDLE,
    clients: Annotated[str, typer.Option(metavar="N,N", help="Clients.")] = "1,4,16,64",
    num: Annotated[int, typer.Option(min=1, max=512, help="Anchors a request.")] = 64,
    sampler: Annotated[str, typer.Option(help="As --samplers of the other two.")] = CARD,
    scenes: ScenesOption = "drawn:8:0",
    seconds: Annotated[float, typer.Option(min=0.1, max=600, help="Of each level.")] = 10.0,
    requests: Annotated[int, typer.Option(min=1, max=100_000, help="Of each level.")] = 2000,
    out: OutOption = RESULTS,
) -> None:
    """Load a server on this machine, and the engine in this process, with closed-loop clients."""
    opened = load_bundle(bundle)
    config = LoadConfig(whole_numbers(clients, "--clients"), seconds, requests)
    spec = parse_sampler(sampler, opened.card)
    found = load_scenes(scenes, limits=limits_of(opened))
    asked = [request_of(scene, num=num, seed=1, sampler=spec) for scene in found]
    with server(bundle, url) as address:
        ways = {
            "in-process": in_process(Engine(opened)),
            "HTTP JSON": over_http(address, OrjsonCodec()),
            "HTTP JSON, standard library": over_http(address, JsonCodec()),
            "HTTP binary": over_http(address, OipCodec()),
        }
        table = load_table(ways, asked, config, progress=say)
    about = {"scenes": scenes, "anchors a request": str(num), "server": url or opened.card.name}
    show_and_write(Report("load", "Load", about | circumstances(), [table]), out)


@contextmanager
def server(bundle: Path, url: str | None) -> Iterator[str]:
    """The URL given, or that of a server of the bundle in a process of its own."""
    if url is not None:
        yield url
        return
    with served("--bundle", str(bundle)) as process:
        yield process.url


app.command()(bench_zenoh.zenoh)
app.command()(bench_zenoh.failover)
app.command()(bench_serving.serving)
app.command()(bench_serving.release)
app.command()(bench_serving.swaps)
app.command()(bench_serving.kill)
app.command()(bench_soak.soak)
app.command("closed-loop")(bench_closed_loop.closed_loop)
