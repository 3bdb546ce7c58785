"""Quality: planners on the same scenes with the same seed, judged, with the time they took."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judge import MEASURES, Judgement, SceneJudge
from anchorflow_benchmarks.planners import Planner
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.ray_signature import Signature

SEED = 1
COUNTS = ("unsafe_called_safe",)  # added up over the scenes; all else is averaged


@dataclass(frozen=True)
class JudgedPlan:
    """What a planner answered for a scene: [N] anchors, their verdict, and the time in ms."""

    scene: FamilyScene
    anchors: Proposals
    verdict: Judgement
    ms: float


Plans = dict[str, list[JudgedPlan]]


def judge_planners(
    planners: Sequence[Planner],
    scenes: Sequence[FamilyScene],
    *,
    limits: MotionLimits,
    num: int,
    routes: Sequence[Sequence[Signature]] | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> Plans:
    """Every planner's plans by its name, scene by scene; `progress` gets 1 a finished scene.

    routes: the known ones of each scene, the shortest first; None to search for them

    The planners take turns on each scene, so that a busy spell of the machine meets all of them.

    Raises:
        BenchmarkError: a planner's answer holds numbers that are not finite.
    """
    plans: Plans = {planner.name: [] for planner in planners}
    for planner in planners:
        planner.plan(scenes[0], num=num, seed=SEED)  # what is slow for once only
    for scene, known in zip(scenes, routes or [None] * len(scenes), strict=True):
        judge = SceneJudge(scene, limits, known)
        for planner in planners:
            start = perf_counter()
            anchors = planner.plan(scene, num=num, seed=SEED)
            ms = (perf_counter() - start) * 1e3
            _check_finite(planner.name, anchors)
            plans[planner.name].append(JudgedPlan(scene, anchors, judge.judge(anchors), ms))
        progress(1)
    return plans


def quality_tables(planners: Sequence[Planner], plans: Plans) -> list[ResultTable]:
    """Over all scenes, those with a choice of routes and each family: a row a planner."""
    families = sorted({plan.scene.family for plan in next(iter(plans.values()))})
    titles: dict[str, Callable[[JudgedPlan], bool]] = {
        "All scenes": lambda _: True,
        "Scenes with a choice of routes": lambda plan: plan.verdict.routes > 1,
    }
    if len(families) > 1:
        titles |= {f"Family {name}": partial(_is_of_family, name) for name in families}
    tables = [quality_table(title, planners, plans, chosen) for title, chosen in titles.items()]
    return [table for table in tables if table.rows]


def quality_table(
    title: str,
    planners: Sequence[Planner],
    plans: Plans,
    chosen: Callable[[JudgedPlan], bool],
) -> ResultTable:
    """A row a planner, over the scenes that are chosen; without rows where none is."""
    chosen_plans = [[plan for plan in plans[p.name] if chosen(plan)] for p in planners]
    pairs = zip(planners, chosen_plans, strict=True)
    rows = [quality_row(planner, some) for planner, some in pairs if some]
    return ResultTable(f"{title} ({len(chosen_plans[0])})", rows)


def quality_row(planner: Planner, plans: Sequence[JudgedPlan]) -> Row:
    """The measures of a planner's plans, averaged over the scenes that have one."""
    measures = [plan.verdict.measures for plan in plans]
    row: dict[str, str | float | int | None] = {"planner": planner.name}
    for name in MEASURES:
        values = np.array([measure[name] for measure in measures])
        row[name] = _total(values) if name in COUNTS else mean_of(values)
    row["evaluations"] = planner.evaluations
    return row | {"ms": float(np.median([plan.ms for plan in plans]))}


def _is_of_family(family: str, plan: JudgedPlan) -> bool:
    return plan.scene.family == family


def mean_of(values: NDArray[np.floating]) -> float:
    """Over the scenes that have a value; NaN where none has."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # numpy's, of an empty mean
        return float(np.nanmean(values)) if len(values) else float("nan")


def _total(values: np.ndarray) -> int | None:
    return None if np.isnan(values).all() else int(np.nansum(values))


def _check_finite(name: str, anchors: Proposals) -> None:
    arrays = (anchors.positions, anchors.velocities, anchors.accelerations)
    if not all(np.isfinite(array).all() for array in arrays):
        raise BenchmarkError(f"{name}: the answer holds numbers that are not finite")
