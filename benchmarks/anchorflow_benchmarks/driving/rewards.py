"""How good what a bundle foretells of its proposals is, and what else it could have chosen by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from anchorflow_benchmarks.driving.bundle_driver import Proposals
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.pdm import SUB_SCORES, PdmScorer
from anchorflow_driving.window import Window

Array = NDArray[np.float64]

TWO_SIDED = ("nc", "dac", "ttc", "c")
"""Those that a proposal passes or fails, so that a curve can be drawn of them."""

CHOICES_NOTE = (
    "PDMS of the proposal that is chosen by the bundle's scores and by each other number that it"
    " tells of its proposals; plain: of the same choice, the best and the nearest before offsets."
)
HEADS_NOTE = (
    "Area under the curve of each foretold sub-score, over all proposals of all windows: the share"
    " of pairs, one that passes and one that fails, in which it is higher for the one that passes."
)


def choice_figures(
    window: Window, proposals: Proposals, *, pdms: Array, scorer: PdmScorer
) -> dict[str, float]:
    """`by NAME` of every other number, and three `plain` ones where there are offsets.

    pdms: [N] of the proposals
    """
    figures = {
        f"by {name}": float(pdms[values.argmax()]) for name, values in proposals.choices.items()
    }
    if proposals.offsets is None:
        return figures
    plain = proposals.trajectories - proposals.offsets
    worth = scorer.score(plain).pdms
    away = np.linalg.norm(plain[..., :2] - window.recorded(PLAN_TIMES)[:, :2], axis=-1)
    return figures | {
        "plain PDMS": float(worth[proposals.best]),
        "plain oracle": float(worth.max()),
        "plain minADE": float(away.mean(-1).min()),
    }


def choices_table(figures: Mapping[str, Sequence[Mapping[str, float]]]) -> ResultTable | None:
    """figures: by driver, `PDMS` and those of `choice_figures` of each window."""
    rows: list[Row] = []
    for name, windows in figures.items():
        told = [key for key in next(iter(windows), {}) if key.startswith(("by ", "plain "))]
        if told:
            means = {key: float(np.mean([w[key] for w in windows])) for key in ("PDMS", *told)}
            rows.append({"driver": name, **means})
    return ResultTable("Choices", rows, CHOICES_NOTE) if rows else None


def heads_table(foretold: Mapping[str, tuple[Array, Array]]) -> ResultTable | None:
    """foretold: by driver, sub-scores [M, 5] as they were foretold and as they were."""
    columns = {sub.upper(): SUB_SCORES.index(sub) for sub in TWO_SIDED}
    rows: list[Row] = []
    for name, (told, true) in foretold.items():
        areas = {sub: area_under_curve(told[:, at], true[:, at]) for sub, at in columns.items()}
        passed = {f"{sub} passed": float((true[:, at] >= 1).mean()) for sub, at in columns.items()}
        rows.append({"driver": name, **areas, **passed})
    return ResultTable("Heads", rows, HEADS_NOTE) if rows else None


def area_under_curve(told: Array, true: Array) -> float:
    """Of numbers [M] that foretell which true sub-scores [M] are 1 (Mann and Whitney, 1947).

    NaN where all pass or all fail.
    """
    passes = true >= 1
    good, bad = int(passes.sum()), int((~passes).sum())
    if not good or not bad:
        return float("nan")
    ranks = rankdata(told)
    return float((ranks[passes].sum() - good * (good + 1) / 2) / (good * bad))
