"""`anchorflow bench routes`: which of a scene's ways round its obstacles do anchors take?"""

from __future__ import annotations

from itertools import zip_longest
from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.baselines import named_baselines
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_benchmarks.planners import engine_planners, limits_of
from anchorflow_benchmarks.quality import judge_planners
from anchorflow_benchmarks.route_quality import (
    ScenesWithAChoice,
    default_sources,
    route_table,
    search_table,
)
from anchorflow_benchmarks.samplers import CARD
from anchorflow_cli.bench_options import (
    RESULTS,
    SCENES,
    STUDENT,
    BundlesOption,
    NumOption,
    OutOption,
    SamplersOption,
    ThreadsOption,
)
from anchorflow_cli.bench_output import progress, report
from anchorflow_service.bundle import DEFAULT_BUNDLE


def routes(
    *,
    bundle: BundlesOption = None,
    scenes: Annotated[
        list[str] | None,
        typer.Option(
            metavar=SCENES,
            help="Scenes: a .npz file, or drawn ones; repeatable.",
            show_default="the public scenes and forests, or drawn:60:0 without them",
        ),
    ] = None,
    routes: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="The known routes of the scenes, a .npz file; repeatable, in order.",
            show_default="they are searched",
        ),
    ] = None,
    limit: Annotated[
        int, typer.Option(min=1, help="Scenes with a choice of routes at most, of each file.")
    ] = 60,
    num: NumOption = 64,
    samplers: SamplersOption = CARD,
    baselines: Annotated[
        str, typer.Option(metavar="A,B", help="Of expert, lines, routes, rrt; none for none.")
    ] = "expert,lines,routes",
    threads: ThreadsOption = None,
    out: OutOption = RESULTS,
) -> None:
    """Count the routes that anchors take, and time the search for them."""
    if len(routes or []) > len(scenes or []):
        raise BenchmarkError("expected at most one --routes for each --scenes")
    bundles = [open_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE, STUDENT]]
    limits, names = limits_of(bundles[0]), [] if baselines == "none" else baselines.split(",")
    planners = [
        *engine_planners(bundles, samplers.split(","), threads=threads),
        *named_baselines(names, bundles[0]),
    ]
    pairs = list(zip_longest(scenes, routes or [])) if scenes else default_sources()
    sources = [
        ScenesWithAChoice.load(source, known, limits=limits, limit=limit) for source, known in pairs
    ]
    tables = []
    for source in sources:
        if not source.scenes:
            raise BenchmarkError(f"{source.name}: no scene has a choice of routes")
        with progress(source.name, len(source.scenes)) as advance:
            plans = judge_planners(
                planners,
                source.scenes,
                limits=limits,
                num=num,
                routes=source.routes,
                progress=advance,
            )
        tables.append(route_table(source, planners, plans))
    with progress("searching", sum(len(source.scenes) for source in sources)) as advance:
        tables.append(search_table(sources, progress=advance))
    report("Routes", {"anchors a scene": str(num)}, tables, out)
