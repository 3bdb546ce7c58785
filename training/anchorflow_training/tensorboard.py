"""Scalars and pictures of a run for TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch.utils.tensorboard import SummaryWriter


class Board:
    """The event files of one run; what a resumed run had written later than its step is hidden."""

    def __init__(self, folder: Path, *, step: int) -> None:
        self.writer = SummaryWriter(str(folder), purge_step=step + 1 if step else None)

    def scalars(self, group: str, row: Mapping[str, float], *, step: int) -> None:
        for name, value in row.items():
            self.writer.add_scalar(f"{group}/{name}", value, step)

    def picture(self, image: NDArray[np.uint8], *, step: int) -> None:
        """image: [height, width, 3]"""
        self.writer.add_image("anchors", image, step, dataformats="HWC")

    def flush(self) -> None:
        self.writer.flush()

    def close(self) -> None:
        self.writer.close()
