"""Compare bundles with plain splines along routes: what is the network worth?

Both start on a scene's routes and end with descents of the same cost. At equal descents only the
flow between them differs; at equal milliseconds its time counts too.
Run by `anchorflow bench earns`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from anchorflow_benchmarks import options
from anchorflow_benchmarks.baselines import DESCENTS, RoutesPlanner, spline_finish, with_descents
from anchorflow_benchmarks.planners import (
    CARD,
    EnginePlanner,
    Planner,
    Proposals,
    bundle_names,
    limits_of,
    open_bundle,
    parse_sampler,
)
from anchorflow_benchmarks.quality import Plans, judge_planners, mean_of, quality_row
from anchorflow_benchmarks.report import ResultTable, Row, progress, report
from anchorflow_benchmarks.scene_files import default_source, in_style, load_scenes
from anchorflow_client.contract.fields import STYLES
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle
from anchorflow_service.engine import Engine
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits

BUNDLE_DESCENTS = DESCENTS[:-1]
ROUTES = "routes"


@dataclass(frozen=True)
class Contender:
    """A source of anchors that are finished with a number of descents."""

    source: str
    descents: int
    planner: Planner


def contenders(
    bundles: Sequence[Bundle], *, sampler: str, threads: int | None = None
) -> list[Contender]:
    """Return bundles with BUNDLE_DESCENTS, and routes with DESCENTS of the first bundle's finish.

    Raises `BenchmarkError` if a bundle's finish is not a spline, or the sampler is unknown;
    `BundleError` if a graph of a bundle cannot be opened.
    """
    finish, limits = spline_finish(bundles[0]), limits_of(bundles[0])
    rivals = [Contender(ROUTES, n, RoutesPlanner(limits, finish, n)) for n in DESCENTS]
    ours = [
        Contender(name, n, EnginePlanner(f"{name} + finish, {n} descents", engine, spec))
        for name, bundle in zip(bundle_names(bundles), bundles, strict=True)
        for spec in [parse_sampler(sampler, bundle.card)]
        for n in BUNDLE_DESCENTS
        for engine in [Engine(descending(bundle, n), threads=threads)]
    ]
    return [*ours, *rivals]


def descending(bundle: Bundle, descents: int) -> Bundle:
    """Return the bundle with another number of descents in its finish; with 0 it only smooths."""
    finish = with_descents(spline_finish(bundle), descents)
    manifest = bundle.manifest.model_copy(update={"finish": finish})
    return replace(bundle, manifest=manifest, card=manifest.card(sha256=bundle.card.sha256))


def ablation_tables(
    contending: Sequence[Contender],
    scenes: Sequence[FamilyScene],
    *,
    limits: MotionLimits,
    num: int,
    progress: Callable[[int], None] = lambda _: None,
) -> list[ResultTable]:
    """Return a table per named style; `progress` gets 1 per scene and style.

    J is the cost of the successes, best J that of the best success. Both are averages over the
    scenes that every contender solves, so that no contender gains by failing in hard scenes.
    """
    tables, planners = [], [one.planner for one in contending]
    for style, weights in STYLES.items():
        styled = [in_style(scene, np.array(weights)) for scene in scenes]
        plans = judge_planners(planners, styled, limits=limits, num=num, progress=progress)
        solved = [
            index
            for index in range(len(scenes))
            if all(plans[one.planner.name][index].verdict.success.any() for one in contending)
        ]
        rows = [_row(one, plans, solved) for one in contending]
        note = f"J over the {len(solved)} of {len(scenes)} scenes that every contender solves"
        tables.append(ResultTable(style, rows, note))
    return tables


def _row(one: Contender, plans: Plans, solved: Sequence[int]) -> Row:
    own = plans[one.planner.name]
    row = quality_row(one.planner, own)
    costs = [_cost(own[i].anchors)[own[i].verdict.success] for i in solved]
    return {
        "source": one.source,
        "descents": one.descents,
        "success": row["success"],
        "J": mean_of(np.array([cost.mean() for cost in costs])),
        "best J": mean_of(np.array([cost.min() for cost in costs])),
        "recall": row["recall"],
        "distinct": row["distinct"],
        "ms": row["ms"],
    }


def _cost(anchors: Proposals) -> NDArray[np.float64]:
    assert anchors.scores is not None  # a finish computes them
    return -anchors.scores


def earns(
    *,
    bundle: options.Bundles = None,
    scenes: options.PublicScenes = None,
    limit: Annotated[int, typer.Option(min=1, help="Scenes at most, evenly spread.")] = 60,
    num: options.Num = 64,
    sampler: options.Sampler = CARD,
    threads: options.Threads = None,
    out: options.Out = options.RESULTS,
) -> None:
    """Finish a bundle's anchors and plain splines along routes with the same descents."""
    bundles = [open_bundle(folder) for folder in bundle or [DEFAULT_BUNDLE, options.STUDENT]]
    limits, source = limits_of(bundles[0]), scenes or default_source()
    contending = contenders(bundles, sampler=sampler, threads=threads)
    found = load_scenes(source, limits=limits, limit=limit)
    with progress("judging", len(found) * len(STYLES)) as advance:
        tables = ablation_tables(contending, found, limits=limits, num=num, progress=advance)
    about = {
        "scenes": f"{Path(source).name}, {len(found)} judged",
        "anchors a scene": str(num),
        "sampler": sampler,
    }
    report("Earnings", about, tables, out)
