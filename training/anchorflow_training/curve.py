"""The course of a run in its folder: one JSON line a report, and the means that a line holds."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anchorflow_training.whole_file import whole_file

Row = dict[str, float]


class LineFile:
    """A file of JSON lines that can be followed while it grows.

    It begins with the rows of the checkpoint that a run resumes from: what came later is dropped.
    """

    def __init__(self, path: Path, rows: Iterable[Row] = ()) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as file:
            file.write("".join(_line(row) for row in rows).encode())

    def append(self, row: Row) -> None:
        with self.path.open("a") as file:
            file.write(_line(row))


class RunningMean:
    """Means of named terms over the steps since the last report."""

    def __init__(self, state: Mapping[str, Any] | None = None) -> None:
        state = state or {"count": 0, "sums": {}}
        self.count: int = state["count"]
        sums = state["sums"].items()
        self.sums: dict[str, Tensor] = {n: torch.tensor(v, dtype=torch.float64) for n, v in sums}

    def add(self, terms: Mapping[str, Tensor]) -> None:
        """Tensors stay on their device, so that a GPU is not waited for."""
        self.count += 1
        for name, value in terms.items():
            self.sums[name] = self.sums[name].to(value) + value if name in self.sums else value

    def means(self) -> Row:
        return {name: float(total) / self.count for name, total in self.sums.items()}

    def state(self) -> dict[str, Any]:
        """What a checkpoint keeps, so that a resumed run reports the same means."""
        return {"count": self.count, "sums": {n: float(v) for n, v in self.sums.items()}}


def _line(row: Row) -> str:
    return json.dumps(row) + "\n"
