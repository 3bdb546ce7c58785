"""Judge anchors on ground that is dear but passable against the cheapest way on the grid.

A path's cost is the integral of 1 + penalty c along it. The cheapest way keeps robot_radius and is
found by Dijkstra's algorithm over 24 neighbours, so smooth anchors may cost a little less.
Run by `anchorflow bench soft-costs`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from anchorflow_benchmarks import options
from anchorflow_benchmarks.baselines import RoutesPlanner, spline_finish
from anchorflow_benchmarks.grid_path import cheapest_way
from anchorflow_benchmarks.planners import (
    CARD,
    EnginePlanner,
    Planner,
    bundle_names,
    limits_of,
    open_bundle,
    parse_sampler,
)
from anchorflow_benchmarks.quality import mean_of
from anchorflow_benchmarks.report import ResultTable, Row, progress, report
from anchorflow_benchmarks.scene_files import default_source, load_scenes
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle
from anchorflow_service.engine import Engine
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost.clearance import distance_to_cells
from anchorflow_trajectory.scene import Scene

PENALTIES = (1.0, 4.0, 10.0)
PATCH = 0.9  # m, the scale of patches
LOOK_EVERY = 0.02  # m along an anchor
PAYS, NEAR = 1.15, 1.1  # times the cheapest: a detour pays from here on; is found up to there


def with_patches(scene: FamilyScene, index: int) -> FamilyScene:
    """Return the scene with smooth patches of risk, drawn by its index."""
    rng = np.random.default_rng(index)
    noise = gaussian_filter(rng.normal(size=scene.occupied.shape), PATCH / scene.resolution)
    raised = (noise - noise.mean()) / noise.std()
    return _with_risk(scene, np.clip((raised - 0.25) / 0.5, 0.0, 1.0) * rng.choice([0.6, 1.0]))


def with_inflation(scene: FamilyScene, index: int) -> FamilyScene:  # noqa: ARG001 a layout's
    """Return the scene with risk about its obstacles, as Nav2's inflation layer has it."""
    distance = distance_to_cells(scene.occupied, scene.resolution)
    return _with_risk(
        scene, np.where(distance < 0.8, np.exp(-3 * np.maximum(distance - 0.25, 0)), 0)
    )


def _with_risk(scene: FamilyScene, risk: NDArray[np.floating]) -> FamilyScene:
    layers = [scene.occupied, np.ones_like(risk), np.where(scene.occupied, 0.0, risk)]
    return replace(scene, cost_map=np.stack(layers).astype(np.float32))


LAYOUTS: dict[str, Callable[[FamilyScene, int], FamilyScene]] = {
    "patches": with_patches,
    "inflation": with_inflation,
}


def path_cost(scene: Scene, path: NDArray[np.floating]) -> float:
    """Return the m that a polyline [K, 2] costs."""
    legs = np.hypot(*np.diff(path, axis=0).T)
    marks = np.append(0.0, legs.cumsum())
    at = np.linspace(0.0, marks[-1], int(marks[-1] / LOOK_EVERY) + 2)
    points = np.stack([np.interp(0.5 * (at[1:] + at[:-1]), marks, axis) for axis in path.T])
    if scene.surcharge is None:
        return float(marks[-1])
    columns, rows = (points - scene.origin[:, None]) / scene.resolution - 0.5
    surcharge = map_coordinates(scene.surcharge, [rows, columns], order=1, mode="nearest")
    return float(marks[-1] * (1.0 + surcharge.mean()))


def soft_cost_row(planner: Planner, scenes: Sequence[FamilyScene], *, num: int) -> Row:
    """Return a planner's figures over scenes with soft costs.

    chosen, any: mean cost of the best by score, and the least, over that of the cheapest way
    moved: share of the scenes with a detour that pays in which the chosen one costs at most NEAR
    """
    chosen, least, moved, spent = [], [], [], []
    for seed, scene in enumerate(scenes):
        shortest = path_cost(scene, cheapest_way(replace(scene, cost_penalty=0.0)))
        best = path_cost(scene, cheapest_way(scene))
        began = time.perf_counter()
        anchors = planner.plan(scene, num=num, seed=seed)
        spent.append(1e3 * (time.perf_counter() - began))
        assert anchors.safe is not None
        assert anchors.scores is not None
        safe = np.flatnonzero(anchors.safe)
        if not len(safe):
            continue
        costs = np.array([path_cost(scene, anchors.positions[n, :, :2]) for n in safe]) / best
        own = costs[np.argmax(anchors.scores[safe])]
        chosen.append(own)
        least.append(costs.min())
        if shortest >= PAYS * best:
            moved.append(own <= NEAR)
    return {
        "planner": planner.name,
        "chosen": mean_of(np.array(chosen)),
        "any": mean_of(np.array(least)),
        "moved": mean_of(np.array(moved, float)),
        "any safe": len(chosen) / len(scenes),
        "ms": float(np.median(spent)),
    }


def planners_of(bundles: Sequence[Bundle], *, threads: int | None) -> list[Planner]:
    """Return each bundle, and its finish on plain splines along the routes."""
    named = zip(bundle_names(bundles), bundles, strict=True)
    ours: list[Planner] = [
        EnginePlanner(name, Engine(bundle, threads=threads), parse_sampler(CARD, bundle.card))
        for name, bundle in named
    ]
    finish = spline_finish(bundles[0])
    return [*ours, RoutesPlanner(limits_of(bundles[0]), finish, finish.steps)]


def soft_costs(
    *,
    bundle: options.Bundles = None,
    scenes: options.PublicScenes = None,
    limit: Annotated[int, typer.Option(min=1, help="Scenes at most, evenly spread.")] = 24,
    num: options.Num = 64,
    threads: options.Threads = None,
    out: options.Out = options.RESULTS,
) -> None:
    """Judge bundles and their finish alone on ground that is dear but passable."""
    bundles = [open_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE, options.STUDENT]]
    source, planners = scenes or default_source(), planners_of(bundles, threads=threads)
    found = load_scenes(source, limits=limits_of(bundles[0]), limit=limit)
    tables = []
    with progress("judging", len(LAYOUTS) * len(PENALTIES) * len(planners)) as advance:
        for name, layout in LAYOUTS.items():
            for penalty in PENALTIES:
                dear = [
                    replace(layout(scene, index), cost_penalty=penalty)
                    for index, scene in enumerate(found)
                ]
                rows = []
                for planner in planners:
                    rows.append(soft_cost_row(planner, dear, num=num))
                    advance(1)
                tables.append(ResultTable(f"{name}, penalty {penalty:g}", rows))
    about = {"scenes": f"{Path(source).name}, {len(found)} judged", "anchors a scene": str(num)}
    report("Soft costs", about, tables, out)
