"""`anchorflow bench earns`: what does a network earn over a search with the same finish?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.earnings import contenders, earnings_tables
from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_benchmarks.planners import limits_of
from anchorflow_benchmarks.samplers import CARD
from anchorflow_benchmarks.scene_files import default_source, load_scenes
from anchorflow_cli.bench_options import (
    RESULTS,
    SCENES,
    STUDENT,
    BundlesOption,
    NumOption,
    OutOption,
    SamplerOption,
    ThreadsOption,
)
from anchorflow_cli.bench_output import progress, report
from anchorflow_cli.extras import needs_extra
from anchorflow_client.contract.styles import STYLES
from anchorflow_service.bundle import DEFAULT_BUNDLE


def earns(
    *,
    bundle: BundlesOption = None,
    scenes: Annotated[
        str | None,
        typer.Option(
            metavar=SCENES,
            help="Scenes: a .npz file, or drawn ones.",
            show_default="the public scenes, or drawn:60:0 without them",
        ),
    ] = None,
    limit: Annotated[int, typer.Option(min=1, help="Scenes at most, evenly spread.")] = 60,
    num: NumOption = 64,
    sampler: SamplerOption = CARD,
    threads: ThreadsOption = None,
    out: OutOption = RESULTS,
) -> None:
    """Finish a bundle's anchors and plain splines along routes with the same descents."""
    with needs_extra("plot", who="anchorflow bench earns"):
        from anchorflow_benchmarks.pictures import draw_cost_over_time
    bundles = [open_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE, STUDENT]]
    limits, source = limits_of(bundles[0]), scenes or default_source()
    contending = contenders(bundles, sampler=sampler, threads=threads)
    found = load_scenes(source, limits=limits, limit=limit)
    with progress("judging", len(found) * len(STYLES)) as advance:
        tables = earnings_tables(contending, found, limits=limits, num=num, progress=advance)
    about = {
        "scenes": f"{Path(source).name}, {len(found)} judged",
        "anchors a scene": str(num),
        "sampler": sampler,
    }
    report("Earnings", about, tables, out)
    draw_cost_over_time(tables, out / "earnings_time.png")
