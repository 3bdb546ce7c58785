"""Routes: how many of a scene's ways round its obstacles planners take, and what a search costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from anchorflow_benchmarks.judge import SceneJudge
from anchorflow_benchmarks.planners import Planner
from anchorflow_benchmarks.quality import Plans, quality_row
from anchorflow_benchmarks.report import ResultTable
from anchorflow_benchmarks.route_files import load_routes
from anchorflow_benchmarks.scene_files import WITHOUT_FILE, data_folder, load_scenes, spread_evenly
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.ray_signature import Signature
from anchorflow_trajectory.route_shortening import pulled_tight
from anchorflow_trajectory.routes import Route, find_routes

COLUMNS = (
    "planner",
    "recall",
    "first",
    "found",
    "distinct",
    "success",
    "any",
    "duration",
    "length",
    "duplicates",
    "evaluations",
    "ms",
)
ROUNDS = 3  # searches of a scene, of which the quickest counts; others use the machine too


@dataclass(frozen=True)
class ScenesWithAChoice:
    """Scenes with two routes or more, and the signatures of each scene's routes.

    total: how many scenes there were to choose from
    """

    name: str
    scenes: list[FamilyScene]
    routes: list[Sequence[Signature]]
    total: int

    @staticmethod
    def load(
        source: str, routes: Path | None, *, limits: MotionLimits, limit: int | None
    ) -> ScenesWithAChoice:
        """At most `limit` of a source, evenly spread; their routes are a file's, or searched.

        Raises:
            BenchmarkError: a file is not what it should be.
        """
        scenes = load_scenes(source, limits=limits)
        known = (
            load_routes(routes, scenes=len(scenes))
            if routes is not None
            else [SceneJudge(scene, limits).of_routes.listed for scene in scenes]
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
    """Scenes and their routes, of the data folder where they lie there, or drawn ones."""
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
    """A row a planner."""
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
    """What finding a scene's routes costs in ms: the search, and with routes pulled tight."""
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
    """ms of the search, and of the search with its routes pulled tight."""
    field, origin, resolution = scene.clearance_field, scene.origin, scene.resolution
    start, goal = scene.x_curr[:2], scene.x_goal[:2]

    def search() -> list[Route]:
        return find_routes(field, resolution=resolution, origin=origin, start=start, goal=goal)

    def tight() -> list[Route]:
        return pulled_tight(search(), field, resolution=resolution, origin=origin)

    calls = (search, tight)
    best = [np.inf, np.inf]
    for _ in range(ROUNDS):
        for k, call in enumerate(calls):
            begun = process_time()
            call()
            best[k] = min(best[k], (process_time() - begun) * 1e3)
    return best[0], best[1]
