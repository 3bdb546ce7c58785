"""How long the PDM score of many proposals takes."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from anchorflow_benchmarks.report import ResultTable
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.log import DrivingLog
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes, Window

COUNTS = (1, 16, 64, 256)
WINDOWS = 40
NOTE = (
    "Milliseconds a window: the reference, made once, and the scores of N proposals, the recorded"
    " plan with its speed (0.5 to 1.5 times) and its course (0.1 rad) changed."
)


def score_time_table(logs: Sequence[DrivingLog]) -> ResultTable:
    """Medians and maxima over windows spread evenly over the logs."""
    windows = [window for log in logs for window in Scenes(log)]
    chosen = [windows[i] for i in np.linspace(0, len(windows) - 1, WINDOWS).astype(int)]
    reference, scored = [], {count: [] for count in COUNTS}
    for window in chosen:
        _ = window.road  # made once a log
        started = perf_counter()
        scorer = PdmScorer(window)
        reference.append(perf_counter() - started)
        for count, times in scored.items():
            plans = proposals(window, count)
            started = perf_counter()
            scorer.score(plans)
            times.append(perf_counter() - started)
    timed = {"reference": reference, **{f"{n} proposals": times for n, times in scored.items()}}
    rows = [
        {"what": name, "ms p50": 1e3 * float(np.median(times)), "ms max": 1e3 * max(times)}
        for name, times in timed.items()
    ]
    return ResultTable(f"Time to score ({len(chosen)} windows)", rows, NOTE)


def proposals(window: Window, count: int) -> np.ndarray:
    """[N, 8, 3]: the recorded plan, faster or slower and turned about the start."""
    rng = np.random.default_rng(window.index)
    plan = window.recorded(PLAN_TIMES)
    faster = rng.uniform(0.5, 1.5, (count, 1))
    turn = rng.normal(0.0, 0.1, (count, 1))
    x, y = faster * plan[:, 0], faster * plan[:, 1]
    cos, sin = np.cos(turn), np.sin(turn)
    return np.stack([cos * x - sin * y, sin * x + cos * y, plan[:, 2] + turn], axis=-1)
