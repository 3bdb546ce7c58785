"""What a run leaves in its folder beside checkpoints: curves, pictures, TensorBoard's files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.checkpoint import CheckpointError
from anchorflow_training.curve import LineFile, Row
from anchorflow_training.pictures import save_picture
from anchorflow_training.tensorboard import Board


class RunRecord:
    """Opened at a step: rows of the checkpoint are kept, what was written later is dropped.

    Raises:
        CheckpointError: there is no place to write, at any call.
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
        self.out = out
        with self._writing():
            self.curve = LineFile(out / "curve.jsonl", curve)
            self.evaluations = LineFile(out / "evaluations.jsonl", evaluations)
            self.board = Board(out / "tensorboard", step=step) if tensorboard else None

    def report(self, step: int, row: Row) -> None:
        with self._writing():
            self.curve.append({"step": step, **row})
            self._scalars("train", step, row)

    def evaluation(self, step: int, row: Row, picture: NDArray[np.uint8] | None) -> None:
        """picture: [height, width, 3]"""
        with self._writing():
            self.evaluations.append({"step": step, **row})
            if picture is not None:
                save_picture(self.out / "samples" / f"{step:06d}.png", picture)
                if self.board:
                    self.board.picture(picture, step=step)
            self._scalars("validation", step, row)

    def _scalars(self, group: str, step: int, row: Row) -> None:
        if self.board:
            self.board.scalars(group, row, step=step)
            self.board.flush()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise CheckpointError(f"{self.out}: expected a place to write ({error})") from error

    def close(self) -> None:
        if self.board:
            self.board.close()
