"""Checkpoints: one file that holds weights, optimiser, configuration, data provenance and curve."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anchorflow_client.errors import AnchorFlowError
from anchorflow_models.registry import UNNAMED


class CheckpointError(AnchorFlowError):
    """A checkpoint cannot be read or written; the message names the file."""


@dataclass(frozen=True)
class Checkpoint:
    """A run as it stood at a step.

    config: the whole `RunConfig`; data: the dataset's own description
    average: exponential moving average of the weights; curve: the loss as it was reported
    evaluations: the validation judge's rows; pending: means since the last report
    scaler: the state of float16's loss scaling
    teacher: of a distilled student, which checkpoint it learnt from
    planner: its name in the registry of planners
    mean_of: of a mean of checkpoints, steps and data of each
    """

    step: int
    config: dict[str, Any]
    data: dict[str, Any]
    model: dict[str, Tensor]
    average: dict[str, Tensor]
    optimiser: dict[str, Any]
    curve: list[dict[str, float]]
    evaluations: list[dict[str, float]] = field(default_factory=list)
    pending: dict[str, Any] = field(default_factory=dict)
    scaler: dict[str, Any] = field(default_factory=dict)
    teacher: dict[str, Any] = field(default_factory=dict)
    planner: str = UNNAMED
    mean_of: list[dict[str, Any]] = field(default_factory=list)


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write whole or not at all: a kill in mid-write leaves the last checkpoint in place.

    Raises:
        CheckpointError: there is no place to write.
    """
    draft = path.with_suffix(".tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        torch.save(vars(checkpoint), draft)
        draft.replace(path)
    except (OSError, RuntimeError) as error:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        # Of a full disk torch says no more than at which byte it noticed.
        why = error if isinstance(error, OSError) else "it broke off, as on a full disk"
        raise CheckpointError(f"{path}: expected a place to write ({why})") from error


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint without running code from it; raises `CheckpointError`."""
    try:
        saved = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: expected a checkpoint, found no file") from error
    except OSError as error:
        raise CheckpointError(f"{path}: {error.strerror}") from error
    except Exception as error:  # whatever torch raises of other bytes, with advice to run them
        raise CheckpointError(f"{path}: not a checkpoint, or one that is cut short") from error
    try:
        return Checkpoint(**saved)
    except TypeError as error:
        raise CheckpointError(f"{path}: not a checkpoint of this version ({error})") from error
