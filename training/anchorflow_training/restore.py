"""What a checkpoint brings back: a model to use, a run to go on with."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from torch import Tensor

from anchorflow_models import L2SafetyCFM
from anchorflow_models.registry import Planner, planner_named
from anchorflow_training.checkpoint import Checkpoint, CheckpointError, load_checkpoint
from anchorflow_training.config import RunConfig
from anchorflow_training.settings import ConfigError, build


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
    """The checkpoint at `path`, if one is there; raises `CheckpointError` if of another model.

    What a field's metadata calls `free` decides nothing of the weights: it may change on the way.
    """
    if not path.exists():
        return None
    saved = load_checkpoint(path)
    _check_same(path, "planner", saved.planner, config.planner)
    then = saved_model_config(saved)
    for name, (old, new) in other_weights(then, config.model).items():
        _check_same(path, f"model.{name}", old, new)
    return saved


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
