"""What a window's proposals and goals are worth, beside the plan that is driven."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from anchorflow_benchmarks.driving.bundle_driver import Proposals
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.geometry import out_of_frame
from anchorflow_driving.window import Window

Array = NDArray[np.float64]

TOP, NEAR_M = 5, 3.0
MOVING_M = 2.0
"""A window moves whose recorded end is so far from now."""
OF_GOALS = ("top 5", "top 5 by score", "off-road score")

PROPOSALS_NOTE = (
    "oracle: the best PDMS of N proposals; minADE: m, of the nearest to the record; rank: Spearman"
    " correlation of score and PDMS where these differ; ms: medians, of drawing what the bundle is"
    " shown, of its flow and scores, and of a plan in all."
)
GOALS_NOTE = (
    f"Shares of the windows that move {MOVING_M:g} m whose recorded end lies within {NEAR_M:g} m of"
    f" one of {TOP} goals: the first that trajectories are drawn to, and those with the highest"
    " scores; and the mean score of goals off the road."
)


def proposal_figures(window: Window, proposals: Proposals, *, pdms: Array) -> dict[str, float]:
    """oracle, minADE, rank, and OF_GOALS where there are goals; NaN where a window has none.

    pdms: [N] of the proposals
    """
    driven = window.recorded(PLAN_TIMES)
    away = np.linalg.norm(proposals.trajectories[..., :2] - driven[:, :2], axis=-1)
    return {
        "oracle": float(pdms.max()),
        "minADE": float(away.mean(-1).min()),
        "rank": _rank(proposals.scores, pdms),
        **_of_goals(window, proposals),
    }


def _rank(scores: Array | None, pdms: Array) -> float:
    if scores is None or np.ptp(pdms) == 0 or np.ptp(scores) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(scores), rankdata(pdms))[0, 1])


def _of_goals(window: Window, proposals: Proposals) -> dict[str, float]:
    goals, scores = proposals.goals, proposals.goal_scores
    if goals is None or scores is None:
        return {}
    end = window.recorded(PLAN_TIMES)[-1, :2]
    near = np.linalg.norm(goals - end, axis=-1) < NEAR_M
    best = np.argsort(-scores, kind="stable")[:TOP]
    moves = bool(np.linalg.norm(end) > MOVING_M)
    off_road = ~window.road.is_drivable(out_of_frame(goals, window.state.pose))
    return {
        "top 5": float(near[:TOP].any()) if moves else float("nan"),
        "top 5 by score": float(near[best].any()) if moves else float("nan"),
        "off-road score": float(scores[off_road].mean()) if off_road.any() else float("nan"),
    }
