"""Files of a run beside checkpoints: curves as JSON lines, pictures, TensorBoard events."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from anchorflow_training.atomic_write import atomic_write, writing
from anchorflow_training.checkpoint import CheckpointError

Row = dict[str, float]
Picture = NDArray[np.uint8]
"""[height, width, 3]"""


class RunningMean:
    """Means of named terms over the steps since the last report."""

    def __init__(self, state: Mapping[str, Any] | None = None) -> None:
        state = state or {"count": 0, "sums": {}}
        self.count: int = state["count"]
        sums = state["sums"].items()
        self.sums: dict[str, Tensor] = {n: torch.tensor(v, dtype=torch.float64) for n, v in sums}

    def add(self, terms: Mapping[str, Tensor]) -> None:
        """Add the terms of a step; tensors stay on their device, so nothing waits for a GPU."""
        self.count += 1
        for name, value in terms.items():
            self.sums[name] = self.sums[name].to(value) + value if name in self.sums else value

    def means(self) -> Row:
        return {name: float(total) / self.count for name, total in self.sums.items()}

    def state(self) -> dict[str, Any]:
        """Return the sums for a checkpoint, so that a resumed run reports the same means."""
        return {"count": self.count, "sums": {n: float(v) for n, v in self.sums.items()}}


class RunRecord:
    """The files of a run, opened at a step: the checkpoint's rows stay, later ones are dropped.

    Raises `CheckpointError` if there is no place to write, at any call.
    """

    def __init__(
        self,
        out: Path,
        *,
        step: int,
        curve: Iterable[Row],
        evaluations: Iterable[Row],
        tensorboard: bool,
    ) -> None:
        self.out, self.board = out, None
        with writing(self.out, CheckpointError):
            out.mkdir(parents=True, exist_ok=True)
            for name, rows in (("curve", curve), ("evaluations", evaluations)):
                with atomic_write(out / f"{name}.jsonl") as file:
                    file.write("".join(json.dumps(row) + "\n" for row in rows).encode())
            if tensorboard:
                folder = str(out / "tensorboard")
                self.board = SummaryWriter(folder, purge_step=step + 1 if step else None)

    def report(self, step: int, row: Row) -> None:
        with writing(self.out, CheckpointError):
            self._append("curve", "train", step, row)

    def evaluation(self, step: int, row: Row, picture: Picture | None) -> None:
        with writing(self.out, CheckpointError):
            if picture is not None:
                from matplotlib.image import imsave

                file = self.out / "samples" / f"{step:06d}.png"
                file.parent.mkdir(parents=True, exist_ok=True)
                imsave(file, picture)
                if self.board:
                    self.board.add_image("anchors", picture, step, dataformats="HWC")
            self._append("evaluations", "validation", step, row)

    def _append(self, name: str, group: str, step: int, row: Row) -> None:
        with (self.out / f"{name}.jsonl").open("a") as file:
            file.write(json.dumps({"step": step, **row}) + "\n")
        if self.board:
            for key, value in row.items():
                self.board.add_scalar(f"{group}/{key}", value, step)
            self.board.flush()

    def close(self) -> None:
        if self.board:
            self.board.close()
