"""Styles: what asking for another one changes in the anchors of the same noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.judge import Judgement, SceneJudge
from anchorflow_benchmarks.planners import Planner
from anchorflow_benchmarks.quality import SEED, mean_of
from anchorflow_benchmarks.report import ResultTable
from anchorflow_client.contract.styles import STYLES
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits

MEASURED = ("duration", "peak", "clear", "jerk", "length")
RATIOS = (
    ("duration", "efficient", "conservative"),
    ("peak", "efficient", "conservative"),
    ("clear", "conservative", "efficient"),
    ("jerk", "comfortable", "efficient"),
)
"""What the names promise: of the first style, over the second."""

Row = dict[str, str | float | int | None]


def style_tables(
    planners: Sequence[Planner],
    scenes: Sequence[FamilyScene],
    *,
    limits: MotionLimits,
    num: int,
    progress: Callable[[int], None] = lambda _: None,
) -> list[ResultTable]:
    """The named styles' anchors, a row a planner and style; and what the names promise, as ratios.

    Means over the scenes in which the planner has a success in every style.
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
    rows, ratios = [], []
    for name, verdicts in found.items():
        means, count = _means(verdicts)
        rows += [
            {"planner": name, "style": style} | means[style] | {"scenes": count} for style in STYLES
        ]
        ratios.append({"planner": name} | _ratios(means) | {"scenes": count})
    words = "; ".join(f"{name} = {weights}" for name, weights in STYLES.items())
    note = "duration: median of a scene's successes; peak: their greatest speeds, m/s, on average"
    return [
        ResultTable("Styles, with the same noise", rows, f"{words}. {note}"),
        ResultTable("Styles, as ratios", ratios),
    ]


def _means(
    verdicts: Mapping[str, Sequence[Judgement]],
) -> tuple[dict[str, dict[str, float]], int]:
    """MEASURED and the share of successes by style, and over how many scenes."""
    scenes = list(zip(*verdicts.values(), strict=True))
    solved = [i for i, styles in enumerate(scenes) if all(v.success.any() for v in styles)]
    means = {}
    for style, own in verdicts.items():
        told = [_measures(own[i]) for i in solved]
        means[style] = {name: mean_of(np.array([one[name] for one in told])) for name in MEASURED}
        means[style]["success"] = mean_of(np.array([v.measures["success"] for v in own]))
    return means, len(solved)


def _measures(verdict: Judgement) -> dict[str, float]:
    """MEASURED of a scene's successes."""

    def of(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values[verdict.success]

    named = {name: verdict.measures[name] for name in ("clear", "jerk", "length")}
    duration = float(np.median(of(verdict.duration)))
    return named | {"duration": duration, "peak": float(of(verdict.peak).mean())}


def _ratios(means: Mapping[str, Mapping[str, float]]) -> Row:
    return {
        f"{measure}, {style} / {other}": means[style][measure] / means[other][measure]
        for measure, style, other in RATIOS
    }
