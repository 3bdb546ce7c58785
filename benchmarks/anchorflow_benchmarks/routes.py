"""Count the routes round a scene's obstacles that planners take, and time the route search.

`anchorflow bench routes` judges scenes with two routes or more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
import typer

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.baselines import named_baselines
from anchorflow_benchmarks.judge import SceneJudge
from anchorflow_benchmarks.options import (
    RESULTS,
    SCENES,
    STUDENT,
    BaselinesOption,
    BundlesOption,
    NumOption,
    OutOption,
    SamplersOption,
    ThreadsOption,
    comma_separated,
)
from anchorflow_benchmarks.planners import CARD, Planner, engine_planners, limits_of, open_bundle
from anchorflow_benchmarks.quality import Plans, judge_planners, quality_row
from anchorflow_benchmarks.report import ResultTable, progress, report
from anchorflow_benchmarks.scene_files import (
    WITHOUT_FILE,
    data_folder,
    load_routes,
    load_scenes,
    spread_evenly,
)
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.routes.homotopy import Signature
from anchorflow_trajectory.routes.search import find_routes
from anchorflow_trajectory.routes.shortening import pulled_tight

COLUMNS = (
    *("planner", "recall", "first", "found", "distinct", "success", "any", "duration"),
    *("length", "duplicates", "evaluations", "ms"),
)
ROUNDS = 3  # searches per scene; the fastest counts


@dataclass(frozen=True)
class ScenesWithAChoice:
    """Scenes with two routes or more, and the signatures of their routes.

    total: number of scenes in the source
    """

    name: str
    scenes: list[FamilyScene]
    routes: list[Sequence[Signature]]
    total: int

    @staticmethod
    def load(
        source: str, routes: Path | None, *, limits: MotionLimits, limit: int | None
    ) -> ScenesWithAChoice:
        """Load at most `limit` scenes, evenly spread; search their routes without a file.

        Raises:
            BenchmarkError: a file cannot be used.
        """
        scenes = load_scenes(source, limits=limits)
        known = (
            load_routes(routes, scenes=len(scenes))
            if routes is not None
            else [SceneJudge(scene, limits).listed_routes for scene in scenes]
        )
        pairs = zip(scenes, known, strict=True)
        chosen = [(scene, listed) for scene, listed in pairs if len(listed) > 1]
        chosen = spread_evenly(chosen, limit)
        return ScenesWithAChoice(
            Path(source).name, [s for s, _ in chosen], [r for _, r in chosen], len(scenes)
        )

    @property
    def mean_routes(self) -> float:
        return float(np.mean([len(listed) for listed in self.routes]))


def default_sources() -> list[tuple[str, Path | None]]:
    """Return the files of public scenes and their routes, or drawn scenes without them."""
    pairs = (
        ("scenes_public.npz", "routes_public.npz"),
        ("forests_public.npz", "forest_routes_public.npz"),
    )
    folder, found = data_folder(), list[tuple[str, Path | None]]()
    for scenes, routes in pairs:
        if (folder / scenes).exists():
            found.append((str(folder / scenes), folder / routes))
    return found or [(WITHOUT_FILE, None)]


def route_table(found: ScenesWithAChoice, planners: Sequence[Planner], plans: Plans) -> ResultTable:
    """Return a row per planner."""
    rows = [quality_row(planner, plans[planner.name]) for planner in planners]
    note = (
        f"{len(found.scenes)} of {found.total} scenes: evenly spread over those with two routes or "
        f"more, {found.mean_routes:.1f} each on average"
    )
    kept = [{column: row.get(column) for column in COLUMNS} for row in rows]
    return ResultTable(f"{found.name} ({len(found.scenes)})", kept, note)


def search_table(
    sources: Sequence[ScenesWithAChoice], *, progress: Callable[[int], None] = lambda _: None
) -> ResultTable:
    """Time the search for a scene's routes in ms, alone and with routes pulled tight."""
    rows = []
    for source in sources:
        times = []
        for scene in source.scenes:
            times.append(_search_ms(scene))
            progress(1)
        search, tight = np.array(times).T
        cells = source.scenes[0].occupied.shape
        rows.append(
            {
                "scenes": source.name,
                "cells": f"{cells[0]} × {cells[1]}",
                "routes": source.mean_routes,
                "search p50": float(np.median(search)),
                "search p99": float(np.percentile(search, 99)),
                "pulled tight p50": float(np.median(tight)),
                "pulled tight p99": float(np.percentile(tight, 99)),
            }
        )
    note = (
        f"ms of processor time on one core, the clearance field known; the least of {ROUNDS} rounds"
    )
    return ResultTable("Search", rows, note)


def _search_ms(scene: FamilyScene) -> tuple[float, float]:
    field, origin, resolution = scene.clearance_field, scene.origin, scene.resolution
    start, goal = scene.x_curr[:2], scene.x_goal[:2]
    best = np.full(2, np.inf)
    for _ in range(ROUNDS):
        begun = process_time()
        found = find_routes(field, resolution=resolution, origin=origin, start=start, goal=goal)
        searched = process_time()
        pulled_tight(found, field, resolution=resolution, origin=origin)
        times = np.array([searched - begun, process_time() - begun])
        best = np.minimum(best, 1e3 * times)
    return float(best[0]), float(best[1])


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
    baselines: BaselinesOption = "expert,lines,routes",
    threads: ThreadsOption = None,
    out: OutOption = RESULTS,
) -> None:
    """Count the routes that anchors take, and time the search for them."""
    if len(routes or []) > len(scenes or []):
        raise BenchmarkError("expected at most one --routes for each --scenes")
    bundles = [open_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE, STUDENT]]
    limits = limits_of(bundles[0])
    planners = [
        *engine_planners(bundles, samplers.split(","), threads=threads),
        *named_baselines(comma_separated(baselines), bundles[0]),
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
