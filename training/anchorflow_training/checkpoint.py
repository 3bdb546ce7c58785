"""Checkpoints: one file that holds weights, optimiser, configuration, data provenance and curve."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor


class CheckpointError(Exception):
    """A checkpoint cannot be read; the message names the file."""


@dataclass(frozen=True)
class Checkpoint:
    """average: the exponential moving average of the weights; curve: the loss as it was reported."""

    step: int
    config: dict[str, Any]
    data: dict[str, Any]
    model: dict[str, Tensor]
    average: dict[str, Tensor]
    optimiser: dict[str, Any]
    curve: list[dict[str, float]]


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write whole or not at all: a kill in mid-write leaves the last checkpoint in place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".tmp")
    torch.save(vars(checkpoint), draft)
    os.replace(draft, path)


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint without running code from it; raises `CheckpointError`."""
    try:
        return Checkpoint(**torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:
        raise CheckpointError(f"{path}: not a checkpoint of this version ({error})") from error
