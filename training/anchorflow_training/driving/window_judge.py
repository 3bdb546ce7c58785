"""The PDM score in the windows of logs, by their number over all logs; it needs no torch."""

from __future__ import annotations

import math
import signal
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.log import read_log
from anchorflow_driving.pdm import PdmScorer, direction_compliance
from anchorflow_driving.window import Scenes, Window

KEPT_LOGS, KEPT_WINDOWS = 256, 256


class WindowJudge:
    """Scores plans in windows; some hundred windows are cached.

    logs: the files; log: [W] which of them each window is of, those of a log beside one another
    direction: whether scores include driving direction compliance
    """

    def __init__(
        self, logs: Sequence[Path], log: NDArray[np.int64], *, direction: bool = False
    ) -> None:
        self._log, self._direction = log, direction
        self._scenes = lru_cache(KEPT_LOGS)(lambda number: Scenes(read_log(logs[number])))
        self._recorded = lru_cache(KEPT_WINDOWS)(lambda window: PdmScorer(self._window(window)))

    def __call__(
        self, window: int, speed: float, plans: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Sub-scores [M, 5] in the order of SUB_SCORES of plans [M, T, 3]; [M, 6] with driving
        direction compliance.

        speed: m/s that the ego begins with; NaN: as recorded
        """
        scorer = (
            self._recorded(window)
            if math.isnan(speed)
            else PdmScorer(self._window(window), speed=speed)
        )
        motion = scorer.motion(plans)
        scores = scorer.judge(motion).sub_scores
        if not self._direction:
            return scores
        compliance = direction_compliance(scorer.metres_against(motion))
        return np.concatenate([scores, compliance[:, None]], axis=-1)

    def _window(self, window: int) -> Window:
        log = int(self._log[window])
        return self._scenes(log)[window - int(np.searchsorted(self._log, log))]


_OF_THIS_PROCESS: list[WindowJudge] = []


def begin_judging(logs: Sequence[Path], log: NDArray[np.int64], direction: bool) -> None:
    """Set up a process for `judge_window`; its parent ends it, Ctrl-C does not."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _OF_THIS_PROCESS[:] = [WindowJudge(logs, log, direction=direction)]


def judge_window(window: int, speed: float, plans: NDArray[np.float64]) -> NDArray[np.float64]:
    """As `WindowJudge`, in a process that `begin_judging` has begun."""
    return _OF_THIS_PROCESS[0](window, speed, plans)
