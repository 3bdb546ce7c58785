"""`anchorflow bench ...`: measure the anchors' quality, the engine's latency, a server's load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.baselines import BASELINES, ExpertPlanner, named_baselines
from anchorflow_benchmarks.diffusion_stages import stage_table
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_benchmarks.latency import (
    Contest,
    LatencyConfig,
    Loop,
    latency_tables,
    onnx_loop,
    torch_loop,
)
from anchorflow_benchmarks.planners import (
    Planner,
    bundle_names,
    engine_planners,
    limits_of,
)
from anchorflow_benchmarks.quality import judge_planners, quality_tables
from anchorflow_benchmarks.robot_quality import AskedRobot
from anchorflow_benchmarks.route_files import load_routes
from anchorflow_benchmarks.samplers import CARD, parse_sampler
from anchorflow_benchmarks.scene_files import default_source, in_style, load_scenes
from anchorflow_benchmarks.style_quality import style_tables
from anchorflow_cli import (
    bench_closed_loop,
    bench_drive,
    bench_drive_closed_loop,
    bench_earns,
    bench_robots,
    bench_routes,
    bench_serving,
    bench_v2x,
    bench_zenoh,
)
from anchorflow_cli.bench_options import (
    RESULTS,
    SCENES,
    BundlesOption,
    NumOption,
    OutOption,
    RecordOption,
    SamplersOption,
    ScenesOption,
    ThreadsOption,
    whole_numbers,
)
from anchorflow_cli.bench_output import progress, record, report, say
from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import (
    AMaxOption,
    RadiusOption,
    StyleOption,
    VMaxOption,
    command_app,
    style_text,
)
from anchorflow_client.contract.checks import number
from anchorflow_client.contract.ranges import A_MAX, GUIDANCE, ROBOT_RADIUS, V_MAX
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle
from anchorflow_trajectory.cores import usable_cores

app = command_app()


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
    routes: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The scenes' known routes, a .npz file.",
            show_default="they are searched",
        ),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Scenes at most.")] = None,
    num: NumOption = 64,
    samplers: SamplersOption = CARD,
    guidance: Annotated[
        str, typer.Option(metavar="A,B", help="Scales of guidance by the cost; 0: none.")
    ] = "0",
    baselines: Annotated[
        str, typer.Option(metavar="A,B", help="Of expert, lines, routes, rrt; none for none.")
    ] = ",".join(BASELINES),
    style: StyleOption = None,
    styles: Annotated[bool, typer.Option(help="Measure what a change of style changes.")] = True,
    v_max: VMaxOption = None,
    a_max: AMaxOption = None,
    radius: RadiusOption = None,
    threads: ThreadsOption = None,
    recorded: RecordOption = False,
    out: OutOption = RESULTS,
) -> None:
    """Judge bundles and baselines on scenes; tables, JSON, Markdown and pictures."""
    with needs_extra("plot", who="anchorflow bench quality"):
        from anchorflow_benchmarks.pictures import draw_quality_over_time, draw_scene_sheet
    for option, value, interval in (
        ("--v-max", v_max, V_MAX),
        ("--a-max", a_max, A_MAX),
        ("--radius", radius, replace(ROBOT_RADIUS, open_low=True)),
    ):
        if value is not None:
            number(value, option, interval)
    folders = bundle or [DEFAULT_BUNDLE]
    bundles = [open_bundle(folder) for folder in folders]
    robot, own = AskedRobot(v_max, a_max, radius), limits_of(bundles[0])
    limits, source = robot.limits(own), scenes or default_source()
    engines = engine_planners(
        bundles,
        samplers.split(","),
        guidance=_scales(guidance),
        limits=limits if v_max or a_max else None,
        threads=threads,
    )
    ours: list[Planner] = [*engines]
    names = [] if baselines == "none" else baselines.split(",")
    with needs_extra("bench", who="anchorflow bench quality --baselines rrt"):
        planners = [*ours, *named_baselines(names, bundles[0], limits)]
    found = [
        in_style(robot.scene(scene, own), style)
        for scene in load_scenes(source, limits=own, limit=limit)
    ]
    known = routes and load_routes(routes, scenes=len(found), limit=limit)
    with progress("judging", len(found)) as advance:
        plans = judge_planners(
            planners, found, limits=limits, num=num, routes=known or None, progress=advance
        )
    tables = quality_tables(planners, plans)
    if styles:
        styled = [*ours, *([ExpertPlanner(limits, 60)] if "expert" in names else [])]
        with progress("styles", len(found)) as advance:
            tables += style_tables(styled, found, limits=limits, num=num, progress=advance)
    about = {
        "scenes": f"{Path(source).name}, {len(found)} judged",
        "anchors a scene": str(num),
        "robot": f"{limits.v_max:g} m/s, {limits.a_max:g} m/s², "
        + ("the scenes' radius" if radius is None else f"{radius:g} m"),
        "style": style_text(style),
    }
    report("Quality", about, tables, out)
    if recorded:
        first = {planner.engine: planner.name for planner in reversed(engines)}
        names = [first[engine] for engine in dict.fromkeys(each.engine for each in engines)]
        record(zip(names, folders, strict=True), about, tables[0])
    draw_scene_sheet(plans[ours[0].name], out / "quality_scenes.png", title=ours[0].name)
    draw_quality_over_time(tables[0].rows, out / "quality_time.png")


def _scales(text: str) -> list[float]:
    """Numbers from 0 on. Raises `BenchmarkError`."""
    try:
        scales = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise BenchmarkError(f"--guidance: expected numbers like 0,0.1, got {text!r}") from error
    for scale in scales:
        number(scale, "refine.guidance", GUIDANCE)
    return scales


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
    stages_of: Annotated[
        list[Path] | None,
        typer.Option(help="A truncated diffusion to time stage by stage, and nothing else."),
    ] = None,
    provider: Annotated[
        list[str] | None,
        typer.Option(
            metavar="cuda|tensorrt|openvino", help="Also ask the engine there; repeatable."
        ),
    ] = None,
    threads: ThreadsOption = None,
    out: OutOption = RESULTS,
) -> None:
    """Time a request in this process against plain loops and the machine's floor."""
    if stages_of:
        table = stage_table(stages_of, rounds=rounds, threads=threads or usable_cores())
        report("Stages", {"threads": str(threads or usable_cores())}, [table], out)
        return
    bundles = [open_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE]]
    config = LatencyConfig(
        counts=whole_numbers(nums, "--nums"),
        rounds=rounds,
        budget_s=budget_s,
        threads=threads or usable_cores(),
        providers=provider or (),
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
    report("Latency", about, tables, out)


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


app.command()(bench_routes.routes)
app.command()(bench_robots.robots)
app.command()(bench_earns.earns)
app.command()(bench_serving.load)
app.command()(bench_zenoh.zenoh)
app.command()(bench_zenoh.failover)
app.command()(bench_serving.serving)
app.command()(bench_serving.release)
app.command()(bench_serving.swaps)
app.command()(bench_serving.kill)
app.command()(bench_serving.soak)
app.command()(bench_drive.drive)
app.command()(bench_drive_closed_loop.drive_closed_loop)
app.command()(bench_v2x.pairs)
app.command()(bench_v2x.florence)
app.command("closed-loop")(bench_closed_loop.closed_loop)
