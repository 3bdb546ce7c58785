"""Checkpoints: one file that holds weights, optimiser, configuration, data provenance and curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anchorflow_client.errors import AnchorFlowError
from anchorflow_models.registry import UNNAMED

# What checkpoints called a loss term, before terms and weights had the names of the fields u, v, w.
FORMER_TERMS = {
    "position": "velocity_field",
    "velocity": "acceleration_field",
    "acceleration": "jerk_field",
    "jerk": "roughness",
}
FORMER_WEIGHTS = {
    "lambda_vel": "lambda_acc",
    "lambda_acc": "lambda_jerk",
    "lambda_jerk": "lambda_roughness",
}


class CheckpointError(AnchorFlowError):
    """A checkpoint cannot be read; the message names the file."""


@dataclass(frozen=True)
class Checkpoint:
    """A run as it stood at a step.

    config: the whole `RunConfig`; data: the dataset's own description
    average: exponential moving average of the weights; curve: the loss as it was reported
    evaluations: the validation judge's rows; pending: means since the last report
    scaler: the state of float16's loss scaling
    teacher: of a distilled student, which checkpoint it learnt from
    planner: its name in the registry of planners

    The first seven are the whole of a checkpoint of the first format, which is still read.
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


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write whole or not at all: a kill in mid-write leaves the last checkpoint in place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".tmp")
    torch.save(vars(checkpoint), draft)
    draft.replace(path)


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint without running code from it; raises `CheckpointError`.

    Loss terms and weights of earlier checkpoints come under the names that they have today.
    """
    try:
        saved = Checkpoint(**torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:
        said = str(error).split("\n", 1)[0]
        raise CheckpointError(
            f"{path}: not a checkpoint of this version ({type(error).__name__}: {said})"
        ) from error
    pending = dict(saved.pending)
    if pending:
        pending["sums"] = _renamed_terms(pending["sums"])
    return replace(
        saved,
        config=_renamed_weights(saved.config),
        curve=[_renamed_terms(row) for row in saved.curve],
        pending=pending,
    )


def _renamed_terms(row: Mapping[str, float]) -> dict[str, float]:
    return {FORMER_TERMS.get(name, name): value for name, value in row.items()}


def _renamed_weights(config: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration with the weights of the loss, wherever they stand, under today's names."""
    result = dict(config)
    for name, value in config.items():
        if not isinstance(value, Mapping):
            continue
        result[name] = _renamed_weights(value)
        if name == "weights" and set(value) == set(FORMER_WEIGHTS):
            former = {FORMER_WEIGHTS[each]: weight for each, weight in value.items()}
            result[name] = {"lambda_vel": 1.0, **former}  # of the positions' part, it was fixed
    return result
