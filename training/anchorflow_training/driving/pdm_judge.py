"""The PDM score of trajectories that a network makes while it learns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_driving.log import read_log
from anchorflow_driving.pdm import PdmScorer, direction_compliance
from anchorflow_driving.window import Scenes, Window

KEPT_LOGS, KEPT_WINDOWS = 256, 256


class PdmJudge:
    """Scores trajectories in the windows of logs, by their number over all logs.

    logs: the files; log: [W] which of them each window is of, those of a log beside one another
    direction: whether it tells driving direction compliance too
    """

    def __init__(
        self, logs: Sequence[Path], log: NDArray[np.int64], *, direction: bool = False
    ) -> None:
        self._log, self._direction = log, direction
        self._scenes = lru_cache(KEPT_LOGS)(lambda number: Scenes(read_log(logs[number])))
        self._scorer = lru_cache(KEPT_WINDOWS)(self._new_scorer)

    def __call__(
        self, windows: Tensor, trajectories: Tensor, speeds: Tensor | None = None
    ) -> Tensor:
        """Sub-scores [B, M, 5] in the order of SUB_SCORES of trajectories [B, M, T, 3]; [B, M, 6]
        with driving direction compliance.

        speeds: [B] m/s that the ego begins with; NaN: as recorded, as is everybody's without them
        """
        plans = trajectories.detach().cpu().double().numpy()
        begun = [math.nan] * len(plans) if speeds is None else speeds.tolist()
        rows = [
            self._judged(
                self._scorer(int(window)) if math.isnan(speed) else self._begun(int(window), speed),
                own,
            )
            for window, speed, own in zip(windows, begun, plans, strict=True)
        ]
        return torch.from_numpy(np.array(rows, np.float32))

    def _judged(self, scorer: PdmScorer, plans: NDArray[np.float64]) -> NDArray[np.float64]:
        """[M, 5 or 6]"""
        motion = scorer.motion(plans)
        scores = scorer.judge(motion).sub_scores
        if not self._direction:
            return scores
        compliance = direction_compliance(scorer.metres_against(motion))
        return np.concatenate([scores, compliance[:, None]], axis=-1)

    def _new_scorer(self, window: int) -> PdmScorer:
        return PdmScorer(self._window(window))

    def _begun(self, window: int, speed: float) -> PdmScorer:
        return PdmScorer(self._window(window), speed=speed)

    def _window(self, window: int) -> Window:
        log = int(self._log[window])
        return self._scenes(log)[window - int(np.searchsorted(self._log, log))]
