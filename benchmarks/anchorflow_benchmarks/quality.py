"""Judge planners on the same scenes and seed, with the time of each plan.

`anchorflow bench quality` prints a table over all scenes, one per family, and those of the styles.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError, options
from anchorflow_benchmarks.baselines import BASELINES, ExpertPlanner, named_baselines
from anchorflow_benchmarks.judge import JudgedPlan, Judgement, SceneJudge
from anchorflow_benchmarks.planners import (
    CARD,
    Planner,
    Proposals,
    engine_planners,
    limits_of,
    open_bundle,
)
from anchorflow_benchmarks.report import ResultTable, Row, progress, record, report
from anchorflow_benchmarks.scene_files import default_source, in_style, load_routes, load_scenes
from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import AMaxOption, RadiusOption, StyleOption, VMaxOption, style_text
from anchorflow_client.contract.checks import number
from anchorflow_client.contract.fields import A_MAX, GUIDANCE, ROBOT_RADIUS, STYLES, V_MAX
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.routes.homotopy import Signature

SEED = 1
ALL_BASELINES = ",".join(BASELINES)
COUNTS = ("unsafe_called_safe",)  # summed over the scenes; the rest is averaged
STYLE_MEASURES = ("duration", "peak", "clear", "jerk", "length")
STYLE_RATIOS = (
    ("duration", "efficient", "conservative"),
    ("peak", "efficient", "conservative"),
    ("clear", "conservative", "efficient"),
    ("jerk", "comfortable", "efficient"),
)
"""Promises of the names: the measure in the first style over that in the second."""


Plans = dict[str, list[JudgedPlan]]


@dataclass(frozen=True)
class RequestedRobot:
    """v_max: m/s; a_max: m/s^2; radius: m. None: as on the bundle's card and in the scene."""

    v_max: float | None = None
    a_max: float | None = None
    radius: float | None = None

    def limits(self, own: MotionLimits) -> MotionLimits:
        """Override the limits of the card."""
        v_max, a_max = self.v_max or own.v_max, self.a_max or own.a_max
        return replace(own, v_max=v_max, a_max=a_max)

    def scene(self, scene: FamilyScene, own: MotionLimits) -> FamilyScene:
        """Return the scene for this robot; velocities at both ends shrink with its limits.

        own: the limits that the scene was drawn for
        """
        limits = self.limits(own)
        slower, weaker = (
            min(1.0, mine / drawn)
            for mine, drawn in ((limits.v_max, own.v_max), (limits.a_max, own.a_max))
        )
        x_curr, x_goal = (state.copy() for state in (scene.x_curr, scene.x_goal))
        dim = len(x_goal) // 2
        x_curr[dim : 2 * dim] *= slower
        x_curr[2 * dim :] *= weaker
        x_goal[dim:] *= slower
        radius = self.radius or scene.robot_radius
        return replace(scene, x_curr=x_curr, x_goal=x_goal, robot_radius=radius, motion=limits)


def judge_planners(
    planners: Sequence[Planner],
    scenes: Sequence[FamilyScene],
    *,
    limits: MotionLimits,
    num: int,
    routes: Sequence[Sequence[Signature]] | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> Plans:
    """Return every planner's plans by its name; `progress` gets 1 per finished scene.

    The planners take turns on each scene, so that a busy spell of the machine affects all of them.

    routes: those of each scene, shortest first; None to search for them

    Raises `BenchmarkError` if a planner's answer holds numbers that are not finite.
    """
    plans: Plans = {planner.name: [] for planner in planners}
    for planner in planners:
        planner.plan(scenes[0], num=num, seed=SEED)  # warm up
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
    """Return tables over all scenes, those with a choice of routes, and each family."""
    families = sorted({plan.scene.family for plan in next(iter(plans.values()))})
    titles: dict[str, Callable[[JudgedPlan], bool]] = {
        "All scenes": lambda _: True,
        "Scenes with a choice of routes": lambda plan: plan.verdict.routes > 1,
    }
    if len(families) > 1:
        titles |= {f"Family {n}": lambda plan, n=n: plan.scene.family == n for n in families}
    tables = []
    for title, chosen in titles.items():
        of = [[plan for plan in plans[planner.name] if chosen(plan)] for planner in planners]
        if of[0]:
            rows = [quality_row(planner, some) for planner, some in zip(planners, of, strict=True)]
            tables.append(ResultTable(f"{title} ({len(of[0])})", rows))
    return tables


def quality_row(planner: Planner, plans: Sequence[JudgedPlan]) -> Row:
    """Average the measures of a planner's plans over the scenes that have a value."""
    measures = [plan.verdict.measures for plan in plans]
    row: dict[str, str | float | int | None] = {"planner": planner.name}
    for name in measures[0]:
        values = np.array([measure[name] for measure in measures])
        row[name] = _total(values) if name in COUNTS else mean_of(values)
    row["evaluations"] = planner.evaluations
    return row | {"ms": float(np.median([plan.ms for plan in plans]))}


def style_tables(
    planners: Sequence[Planner],
    scenes: Sequence[FamilyScene],
    *,
    limits: MotionLimits,
    num: int,
    progress: Callable[[int], None] = lambda _: None,
) -> list[ResultTable]:
    """Return a table with a row per planner and named style, and the ratios between styles.

    All styles get the same noise. Means are over the scenes that the planner solves in every style.
    """
    found = {planner.name: {style: list[Judgement]() for style in STYLES} for planner in planners}
    for scene in scenes:
        judge = SceneJudge(scene, limits)
        for planner in planners:
            for name, weights in STYLES.items():
                styled = replace(scene, w_style=np.array(weights, np.float32))
                verdict = judge.judge(planner.plan(styled, num=num, seed=SEED))
                found[planner.name][name].append(verdict)
        progress(1)
    rows: list[Row] = []
    ratios: list[Row] = []
    for name, verdicts in found.items():
        means, count = _style_means(verdicts)
        rows += [
            {"planner": name, "style": style} | means[style] | {"scenes": count} for style in STYLES
        ]
        of_styles = {
            f"{measure}, {style} / {other}": means[style][measure] / means[other][measure]
            for measure, style, other in STYLE_RATIOS
        }
        ratios.append({"planner": name} | of_styles | {"scenes": count})
    words = "; ".join(f"{name} = {weights}" for name, weights in STYLES.items())
    note = "duration: median of a scene's successes; peak: their greatest speeds, m/s, on average"
    return [
        ResultTable("Styles, with the same noise", rows, f"{words}. {note}"),
        ResultTable("Styles, as ratios", ratios),
    ]


def quality(
    *,
    bundle: options.Bundles = None,
    scenes: options.PublicScenes = None,
    routes: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The scenes' known routes, a .npz file.",
            show_default="they are searched",
        ),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Scenes at most.")] = None,
    num: options.Num = 64,
    samplers: options.Samplers = CARD,
    guidance: Annotated[
        str, typer.Option(metavar="A,B", help="Scales of guidance by the cost; 0: none.")
    ] = "0",
    baselines: options.Baselines = ALL_BASELINES,
    style: StyleOption = None,
    styles: Annotated[bool, typer.Option(help="Measure what a change of style changes.")] = True,
    v_max: VMaxOption = None,
    a_max: AMaxOption = None,
    radius: RadiusOption = None,
    threads: options.Threads = None,
    recorded: options.Record = False,
    out: options.Out = options.RESULTS,
) -> None:
    """Judge bundles and baselines on scenes; tables, JSON and Markdown."""
    for option, value, interval in (
        ("--v-max", v_max, V_MAX),
        ("--a-max", a_max, A_MAX),
        ("--radius", radius, replace(ROBOT_RADIUS, open_low=True)),
    ):
        if value is not None:
            number(value, option, interval)
    folders = bundle or [DEFAULT_BUNDLE]
    bundles = [open_bundle(folder) for folder in folders]
    robot, own = RequestedRobot(v_max, a_max, radius), limits_of(bundles[0])
    limits, source = robot.limits(own), scenes or default_source()
    engines = engine_planners(
        bundles,
        samplers.split(","),
        guidance=_scales(guidance),
        limits=limits if v_max or a_max else None,
        threads=threads,
    )
    ours: list[Planner] = [*engines]
    names = options.comma_separated(baselines)
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


def mean_of(values: NDArray[np.floating]) -> float:
    """Return the mean of the values that are not NaN; NaN if all are."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # numpy warns of an empty mean
        return float(np.nanmean(values)) if len(values) else float("nan")


def _scales(text: str) -> list[float]:
    try:
        scales = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise BenchmarkError(f"--guidance: expected numbers like 0,0.1, got {text!r}") from error
    for scale in scales:
        number(scale, "refine.guidance", GUIDANCE)
    return scales


def _total(values: np.ndarray) -> int | None:
    return None if np.isnan(values).all() else int(np.nansum(values))


def _check_finite(name: str, anchors: Proposals) -> None:
    arrays = (anchors.positions, anchors.velocities, anchors.accelerations)
    if not all(np.isfinite(array).all() for array in arrays):
        raise BenchmarkError(f"{name}: the answer holds numbers that are not finite")


def _style_means(
    verdicts: Mapping[str, Sequence[Judgement]],
) -> tuple[dict[str, dict[str, float]], int]:
    """Return STYLE_MEASURES and the share of successes by style, and the number of scenes."""
    scenes = list(zip(*verdicts.values(), strict=True))
    solved = [i for i, styles in enumerate(scenes) if all(v.success.any() for v in styles)]
    means = {}
    for style, own in verdicts.items():
        found = [_style_measures(own[i]) for i in solved]
        means[style] = {
            name: mean_of(np.array([one[name] for one in found])) for name in STYLE_MEASURES
        }
        means[style]["success"] = mean_of(np.array([v.measures["success"] for v in own]))
    return means, len(solved)


def _style_measures(verdict: Judgement) -> dict[str, float]:
    good = verdict.success
    named = {name: verdict.measures[name] for name in ("clear", "jerk", "length")}
    duration, peak = float(np.median(verdict.duration[good])), float(verdict.peak[good].mean())
    return named | {"duration": duration, "peak": peak}
