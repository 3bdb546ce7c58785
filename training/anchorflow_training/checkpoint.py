"""Checkpoints: written, read, restored to a model or a run, and averaged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anchorflow_client.errors import AnchorFlowError
from anchorflow_models import L2SafetyCFM
from anchorflow_models.registry import UNNAMED, Planner, planner_named
from anchorflow_training.atomic_write import atomic_write
from anchorflow_training.config import RunConfig
from anchorflow_training.settings import ConfigError, build


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

    Raises `CheckpointError` if there is no place to write.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            torch.save(vars(checkpoint), file)
    except (OSError, RuntimeError) as error:
        # If the disk is full, torch only names the byte at which it noticed.
        why = error if isinstance(error, OSError) else "it broke off, as on a full disk"
        raise CheckpointError(f"{path}: expected a place to write ({why})") from error


def load_checkpoint(path: Path, *, in_file: bool = False) -> Checkpoint:
    """Read a checkpoint without running code from it; raises `CheckpointError`.

    in_file: arrays stay in the file until they are used, which saves the optimiser's gigabytes;
        whoever then writes into that file ends this process
    """
    try:
        saved = torch.load(path, map_location="cpu", weights_only=True, mmap=in_file)
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


def restore_model(checkpoint: Checkpoint) -> Any:
    """The trained model with its averaged weights, ready to use; raises `CheckpointError`."""
    planner, config = _planner(checkpoint), saved_model_config(checkpoint)
    model = planner.create(config)
    try:
        model.load_state_dict(checkpoint.average)
    except RuntimeError as error:
        raise CheckpointError(f"the weights do not fit the model ({error})") from error
    return model.eval()


def restore_flow(checkpoint: Checkpoint) -> L2SafetyCFM:
    """FlowMP's flow, for what works with no other planner; raises `CheckpointError`."""
    if checkpoint.planner != "flowmp":
        raise CheckpointError(f"expected a checkpoint of flowmp, got one of {checkpoint.planner}")
    return restore_model(checkpoint)


def saved_model_config(checkpoint: Checkpoint) -> Any:
    """The model's part of a checkpoint's configuration; what it does not name has its default."""
    try:
        return build(_planner(checkpoint).config, checkpoint.config["model"], source="checkpoint")
    except ConfigError as error:
        raise CheckpointError(str(error)) from error


def resumable(path: Path, config: RunConfig) -> Checkpoint | None:
    """Return the checkpoint at `path`, if any; raise `CheckpointError` if it is of another model.

    Fields that are `free` by their metadata do not affect the weights and may change.
    """
    if not path.exists():
        return None
    saved = load_checkpoint(path)
    _check_same(path, "planner", saved.planner, config.planner)
    then = saved_model_config(saved)
    for name, (old, new) in other_weights(then, config.model).items():
        _check_same(path, f"model.{name}", old, new)
    return saved


def model_before(path: str | None, planner: str) -> dict[str, Any]:
    """The model's settings of the checkpoint that a run begins with, if it is of the planner."""
    saved = load_checkpoint(Path(path)) if path else None
    return dict(saved.config["model"]) if saved and saved.planner == planner else {}


def weights_before(path: str, config: RunConfig) -> dict[str, Tensor]:
    """The averaged weights of the checkpoint that a run begins with; raises `ConfigError`."""
    saved = load_checkpoint(Path(path))
    if saved.planner != config.planner:
        raise ConfigError(
            f"before: {path}: expected a checkpoint of {config.planner}, got one of {saved.planner}"
        )
    before = restore_model(saved)
    for name, (old, new) in other_weights(saved_model_config(saved), config.model).items():
        if new and not old and _may_come_later(config.model, name):
            continue
        raise ConfigError(f"before: {path}: expected model.{name} {new!r}, got {old!r}")
    return before.state_dict()


def other_weights(then: Any, now: Any) -> dict[str, tuple[Any, Any]]:
    """What decides the weights and differs between two configurations of a model, by field."""
    names = [part.name for part in fields(now) if not part.metadata.get("free")]
    both = {name: (getattr(then, name), getattr(now, name)) for name in names}
    return {name: (old, new) for name, (old, new) in both.items() if old != new}


def _may_come_later(config: Any, name: str) -> bool:
    """Whether a part of the network may begin anew where the run before had none."""
    (part,) = (part for part in fields(config) if part.name == name)
    return part.metadata.get("may_come_later", False)


def _check_same(path: Path, name: str, old: Any, new: Any) -> None:
    if old != new:
        raise CheckpointError(
            f"{path}: expected {name} {old!r}, as it was trained, got {new!r}; "
            "another folder begins a new run"
        )


def _planner(checkpoint: Checkpoint) -> Planner:
    try:
        return planner_named(checkpoint.planner)
    except ValueError as error:
        raise CheckpointError(str(error)) from error


TOKENIZER = "_extra_state"  # of V2X-VLM
COUNTER = "num_batches_tracked"  # of batch normalisation


def mean_checkpoint(paths: Sequence[Path]) -> Checkpoint:
    """The last of some checkpoints of one network, its averaged weights the mean of all of theirs.

    Weights that began alike and then learnt on, for longer or from other data, may have a mean
    that is better than each (Wortsman et al., *Model soups*, ICML 2022); weights that began apart
    do not.

    Raises `CheckpointError` if one cannot be read, or is of another planner, network or tokenizer
    than the last.
    """
    *others, last = [load_checkpoint(path) for path in paths]
    wanted = saved_model_config(last)
    for path, other in zip(paths, others, strict=False):
        if other.planner != last.planner:
            raise CheckpointError(f"{path}: expected {last.planner}, got {other.planner}")
        for name, (old, new) in other_weights(saved_model_config(other), wanted).items():
            raise CheckpointError(f"{path}: expected model.{name} {new!r}, got {old!r}")
        for name, value in last.average.items():
            if _decides(name, value) and not torch.equal(other.average[name], value):
                what = "tokenizer" if name == TOKENIZER else name
                raise CheckpointError(f"{path}: expected the {what} of {paths[-1]}, got another")
    every = [*others, last]
    average = {
        name: torch.stack([each.average[name] for each in every]).mean(0)
        if value.is_floating_point()
        else value
        for name, value in last.average.items()
    }
    parts = [{"steps": each.step, "data": each.data} for each in every]
    return replace(last, average=average, mean_of=parts)


def _decides(name: str, value: Tensor) -> bool:
    """Whether an entry is no weight and has no mean, but says what the weights are for."""
    return not value.is_floating_point() and not name.endswith(COUNTER)


CURVE_POINTS = 40


def provenance(checkpoint: Checkpoint) -> dict[str, Any]:
    """Steps, configuration, data and a thinned loss curve; of a student its teacher too, and of a
    mean what it is the mean of.
    """
    stride = max(1, len(checkpoint.curve) // CURVE_POINTS)
    more = {"teacher": checkpoint.teacher, "mean_of": checkpoint.mean_of}
    return {
        "steps": checkpoint.step,
        "config": checkpoint.config,
        "data": checkpoint.data,
        "loss": [[row["step"], round(row["loss"], 4)] for row in checkpoint.curve[::stride]],
        **{name: value for name, value in more.items() if value},
    }
