"""What a bundle's network earns: the same finish on its anchors and on plain splines along routes.

Both begin on a scene's routes and end with descents of the same cost. At equal descents only the
flow between them differs; at equal milliseconds, what it costs is paid for too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.finish import with_descents
from anchorflow_benchmarks.planners import EnginePlanner, Planner, bundle_names, limits_of
from anchorflow_benchmarks.quality import Plans, judge_planners, mean_of, quality_row
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.routes_planner import DESCENTS, RoutesPlanner
from anchorflow_benchmarks.samplers import parse_sampler
from anchorflow_benchmarks.scene_files import in_style
from anchorflow_client.contract.styles import STYLES
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.manifest import SplineEntry
from anchorflow_service.engine import Engine
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.scene import Scene

OF_BUNDLES = DESCENTS[:-1]  # what needs more has no use for a network
RIVAL = "routes"


@dataclass(frozen=True)
class Contender:
    """Something that proposes anchors, finished with so many descents."""

    source: str
    descents: int
    planner: Planner

    @property
    def name(self) -> str:
        return f"{self.source} + finish, {self.descents} descents"

    @property
    def evaluations(self) -> int | None:
        return self.planner.evaluations

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        """What the planner proposes."""
        return self.planner.plan(scene, num=num, seed=seed)


def contenders(
    bundles: Sequence[Bundle], *, sampler: str, threads: int | None = None
) -> list[Contender]:
    """Each bundle with OF_BUNDLES descents of its own finish, routes with DESCENTS of the first's.

    Raises:
        BenchmarkError: a bundle's finish is no spline, or the sampler is unknown.
        BundleError: a graph of a bundle cannot be opened.
    """
    finish, limits = _spline_of(bundles[0]), limits_of(bundles[0])
    rivals = [Contender(RIVAL, n, RoutesPlanner(limits, finish, n)) for n in DESCENTS]
    ours = [
        Contender(name, descents, EnginePlanner(name, engine, spec))
        for name, bundle in zip(bundle_names(bundles), bundles, strict=True)
        for spec in [parse_sampler(sampler, bundle.card)]
        for descents in OF_BUNDLES
        for engine in [Engine(descending(bundle, descents), threads=threads)]
    ]
    return [*ours, *rivals]


def descending(bundle: Bundle, descents: int) -> Bundle:
    """The bundle with so many descents in its finish; without any it smooths alone."""
    finish = with_descents(_spline_of(bundle), descents)
    manifest = bundle.manifest.model_copy(update={"finish": finish})
    return replace(bundle, manifest=manifest, card=replace(bundle.card, finish=finish.spec()))


def earnings_tables(
    contending: Sequence[Contender],
    scenes: Sequence[FamilyScene],
    *,
    limits: MotionLimits,
    num: int,
    progress: Callable[[int], None] = lambda _: None,
) -> list[ResultTable]:
    """A table a named style, a row a contender; `progress` gets 1 a scene and style.

    J: cost of the successes; best J: of the best of them. Averages over the scenes in which every
    contender has a success, so that nobody gains by failing where it is hard.
    """
    tables = []
    for style, weights in STYLES.items():
        styled = [in_style(scene, np.array(weights)) for scene in scenes]
        plans = judge_planners(contending, styled, limits=limits, num=num, progress=progress)
        solved = [
            index
            for index in range(len(scenes))
            if all(plans[one.name][index].verdict.success.any() for one in contending)
        ]
        rows = [_row(one, plans, solved) for one in contending]
        note = f"J over the {len(solved)} of {len(scenes)} scenes that every contender solves"
        tables.append(ResultTable(style, rows, note))
    return tables


def _row(one: Contender, plans: Plans, solved: Sequence[int]) -> Row:
    row = quality_row(one, plans[one.name])
    costs = [
        _cost(plan.anchors)[plan.verdict.success] for plan in (plans[one.name][i] for i in solved)
    ]
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
    """J [N]."""
    assert anchors.scores is not None  # of a finish
    return -anchors.scores


def _spline_of(bundle: Bundle) -> SplineEntry:
    finish = bundle.manifest.finish
    if not isinstance(finish, SplineEntry):
        raise BenchmarkError(
            f"{bundle.card.name}: expected a bundle whose finish is a spline, got {finish.kind!r}"
        )
    return finish
