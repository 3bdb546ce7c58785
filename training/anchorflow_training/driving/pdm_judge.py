"""The PDM score of trajectories that a network makes while it learns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_driving.log import read_log
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes

KEPT_LOGS, KEPT_WINDOWS = 64, 2048


class PdmJudge:
    """Scores trajectories in the windows of logs, by their number over all logs.

    logs: the files; log: [W] which of them each window is of, those of a log beside one another
    """

    def __init__(self, logs: Sequence[Path], log: NDArray[np.int64]) -> None:
        self._log = log
        self._scenes = lru_cache(KEPT_LOGS)(lambda number: Scenes(read_log(logs[number])))
        self._scorer = lru_cache(KEPT_WINDOWS)(self._new_scorer)

    def __call__(self, windows: Tensor, trajectories: Tensor) -> Tensor:
        """Sub-scores [B, M, 5] in the order of SUB_SCORES of trajectories [B, M, T, 3]."""
        plans = trajectories.detach().cpu().double().numpy()
        rows = [
            self._scorer(int(window)).score(own).sub_scores
            for window, own in zip(windows, plans, strict=True)
        ]
        return torch.from_numpy(np.array(rows, np.float32))

    def _new_scorer(self, window: int) -> PdmScorer:
        log = int(self._log[window])
        first = int(np.searchsorted(self._log, log))
        return PdmScorer(self._scenes(log)[window - first])
