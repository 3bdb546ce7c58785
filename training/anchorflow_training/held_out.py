"""Which scenes a run trains on and which it is judged on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.batches import BatchConfig
from anchorflow_training.config import CostMapRunConfig
from anchorflow_training.dataset import SceneDataset, open_dataset
from anchorflow_training.settings import ConfigError, check_fixed


def split(
    dataset: SceneDataset, config: CostMapRunConfig
) -> tuple[SceneDataset, SceneDataset | None]:
    """The scenes to train on and those held out, if any; raises `ConfigError`."""
    held_out, path = config.evaluation.held_out, config.evaluation.dataset
    if held_out and path:
        raise ConfigError("evaluation: expected held_out or dataset, got both")
    left_to_learn(
        len(dataset), of=f"the scenes of {dataset.path}", held_out=held_out, batch=config.batch
    )
    training, judged = dataset, open_dataset(Path(path)) if path else None
    if held_out:
        training = _part(dataset, slice(None, -held_out))
        judged = _part(dataset, slice(-held_out, None))
    for part in (training, judged):
        if part:
            check_fixed(config.model, shapes(part), by=f"the scenes of {part.path}")
    return training, judged


def left_to_learn(
    count: int,
    *,
    of: str,
    held_out: int,
    batch: BatchConfig,
    log: NDArray[np.integer] | None = None,
) -> int:
    """How many of `count`, which `of` names, are trained on; raises `ConfigError` if too few.

    log: [count], ascending: the log of each. None is parted, since its windows show one another's
        futures: the one that `held_out` reaches into is held out whole
    """
    if held_out >= count:
        raise ConfigError(f"evaluation.held_out: expected less than {count}, {of}, got {held_out}")
    left = count - held_out
    less = "evaluation.held_out"
    if log is not None and held_out:
        left = int(np.searchsorted(log, log[left]))
        less = f"the logs of {less}"
    if left < batch.scenes:
        raise ConfigError(
            f"batch.scenes: expected at most {left}, {of} less {less}, got {batch.scenes}"
        )
    return left


def means(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Of each figure over the rows in which it counts and is not NaN; 0 where it does in none."""
    counted = {name: [r[name] for r in rows if not math.isnan(r[name])] for name in rows[0]}
    return {name: fmean(values or [0.0]) for name, values in counted.items()}


def _part(dataset: SceneDataset, scenes: slice) -> SceneDataset:
    arrays = {name: array[scenes] for name, array in dataset.arrays.items()}
    return replace(dataset, arrays=arrays)


def shapes(dataset: SceneDataset) -> dict[str, int]:
    """What of FlowMP's configuration a dataset fixes: T, D and C."""
    return {name: getattr(dataset, name) for name in ("num_steps", "dim", "map_channels")}
