"""Averages of weights: of one run as it goes, which is what is used after it, and of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from anchorflow_training.checkpoint import Checkpoint, CheckpointError, load_checkpoint
from anchorflow_training.restore import other_weights, saved_model_config

TOKENIZER = "_extra_state"  # of V2X-VLM
COUNTER = "num_batches_tracked"  # of batch normalisation


@torch.no_grad()
def update_average(
    average: dict[str, Tensor], model: nn.Module, *, decay: float, step: int
) -> None:
    """Move the average towards the weights, in place; early in a run it follows faster."""
    share = 1 - min(decay, (1 + step) / (10 + step))
    for name, value in model.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, share)
        else:
            average[name].copy_(value)


def mean_checkpoint(paths: Sequence[Path]) -> Checkpoint:
    """The last of some checkpoints of one network, its averaged weights the mean of all of theirs.

    Weights that began alike and then learnt on, for longer or from other data, may have a mean
    that is better than each (Wortsman et al., *Model soups*, ICML 2022); weights that began apart
    do not.

    Raises:
        CheckpointError: one cannot be read, or is of another planner, network or tokenizer than
            the last.
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
