"""The PDM score of trajectories that a network makes while it learns."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_training.driving.window_judge import (
    WindowJudge,
    begin_judging,
    judge_window,
)

Judge = Callable[[Tensor, Tensor, Tensor | None], Tensor]
"""PDM sub-scores [B, M, 5] in [0, 1], or [B, M, 6] with DDC, of trajectories [B, M, T, 3] in
windows [B], by number, with the ego's initial speeds [B]; NaN or None: as recorded."""


class PdmJudge:
    """A `Judge` of the windows of logs.

    A window takes some 40 ms of one core, and a whole step hardly longer on a GPU. So processes of
    their own may share the windows: those of a log go to the same one always, which keeps it.

    logs, log, direction: as `WindowJudge` takes them
    processes: beside this one, which begin when they are first asked; 0: this one does it all
    """

    def __init__(
        self,
        logs: Sequence[Path],
        log: NDArray[np.int64],
        *,
        direction: bool = False,
        processes: int = 0,
    ) -> None:
        self._logs, self._log, self._direction = logs, log, direction
        self._processes = processes

    def __call__(
        self, windows: Tensor, trajectories: Tensor, speeds: Tensor | None = None
    ) -> Tensor:
        plans = trajectories.detach().cpu().double().numpy()
        begun = [float("nan")] * len(plans) if speeds is None else speeds.tolist()
        asked = zip(windows.tolist(), begun, plans, strict=True)
        if not self._processes:
            rows = [self._own(*each) for each in asked]
        else:
            told = [self._judge_of(each[0]).submit(judge_window, *each) for each in asked]
            rows = [each.result() for each in told]
        return torch.from_numpy(np.array(rows, np.float32))

    @cached_property
    def _own(self) -> WindowJudge:
        return WindowJudge(self._logs, self._log, direction=self._direction)

    @cached_property
    def _others(self) -> Sequence[ProcessPoolExecutor]:
        # Not forked: what torch's threads hold in that moment would be held for ever.
        context = multiprocessing.get_context("spawn")
        told = (self._logs, self._log, self._direction)
        return [
            ProcessPoolExecutor(1, context, begin_judging, told) for _ in range(self._processes)
        ]

    def _judge_of(self, window: int) -> ProcessPoolExecutor:
        return self._others[int(self._log[window]) % self._processes]


def judged(
    judge: Judge, batch: Mapping[str, Tensor], trajectories: Tensor, speeds: Tensor | None = None
) -> Tensor:
    """Return the sub-scores of trajectories in the windows of a batch, which may be reflected.

    batch: with window [B], and signs [B, 3] of its poses
    """
    recorded = trajectories * batch["signs"][:, None, None]
    return judge(batch["window"], recorded, speeds).to(trajectories)
