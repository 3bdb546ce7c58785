"""`anchorflow bench robots`: one bundle for robots of all speeds and sizes?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_benchmarks.planners import engine_planners, limits_of
from anchorflow_benchmarks.robot_quality import RADII, SPEEDS, robot_tables
from anchorflow_benchmarks.samplers import CARD
from anchorflow_benchmarks.scene_files import default_source, in_style, load_scenes
from anchorflow_cli.bench_options import (
    RESULTS,
    SCENES,
    BundlesOption,
    NumOption,
    OutOption,
    SamplersOption,
    ThreadsOption,
)
from anchorflow_cli.bench_output import progress, report
from anchorflow_cli.options import StyleOption, style_text
from anchorflow_service.bundle import DEFAULT_BUNDLE


def robots(
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
    samplers: SamplersOption = CARD,
    style: StyleOption = None,
    threads: ThreadsOption = None,
    out: OutOption = RESULTS,
) -> None:
    """Ask for the same scenes as robots of other speeds and radii would, and judge the anchors."""
    bundles = [open_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE]]
    own, source = limits_of(bundles[0]), scenes or default_source()
    planners = engine_planners(bundles, samplers.split(","), threads=threads)
    found = [in_style(scene, style) for scene in load_scenes(source, limits=own, limit=limit)]
    with progress("judging", len(found) * (len(SPEEDS) + len(RADII))) as advance:
        tables = robot_tables(planners, found, own=own, num=num, progress=advance)
    about = {
        "scenes": f"{Path(source).name}, {len(found)} at most",
        "anchors a scene": str(num),
        "style": style_text(style),
    }
    report("Robots", about, tables, out)
