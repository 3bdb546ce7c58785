"""Training batches: a few scenes, many samples of each, so that a map is encoded once for many.

Batch i depends on the seed and on i alone; a run that resumes sees what it would have seen.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.dataset import SceneDataset
from anchorflow_training.reflection import reflection
from anchorflow_training.settings import setting

Batch = dict[str, NDArray[Any]]

# What a model's encode takes, by its own names.
INPUTS = (
    "cost_map",
    "map_geometry",
    "clearance_field",
    "cost_to_go",
    "x_curr",
    "x_goal",
    "w_style",
)


@dataclass(frozen=True)
class BatchConfig:
    """scenes: B; samples: N a scene (each trajectory is used samples / M times)."""

    scenes: int = setting(16, "Scenes a batch.", least=1)
    samples: int = setting(32, "Samples a scene.", least=1)
    seed: int = setting(0, "Of weights, batches and noise.", least=0)
    mirror: bool = setting(True, "Reflect half of the batches; false where left is not right.")


def draw_batch(dataset: SceneDataset, config: BatchConfig, index: int) -> Batch:
    """Batch number `index`: the inputs of encode [B, ...] and states [B, N, T, S].

    sample_weights [B, N], where the dataset has a quality, say what each counts in the loss.
    """
    batch = dataset.batch(batch_scenes(len(dataset), config, index))
    rng = batch_rng(config, index)
    if rng.random() < 0.5 and config.mirror:
        mirror(batch)
    states = batch["states"]
    chosen = [
        rng.permutation(np.resize(np.arange(states.shape[1]), config.samples)) for _ in states
    ]
    picked = np.stack(chosen)
    states = np.take_along_axis(states, picked[..., None, None], 1)
    drawn = encode_inputs(batch) | {"states": states}
    if dataset.mean_quality is not None:
        # Their mean is 1 over the dataset, so that they leave the size of a step alone.
        quality = np.take_along_axis(batch["quality"], picked, 1)
        drawn["sample_weights"] = (quality / dataset.mean_quality).astype(np.float32)
    return drawn


def batch_scenes(total: int, config: BatchConfig, index: int) -> NDArray[np.int64]:
    """Which of `total` scenes batch number `index` shows, in order; every epoch shuffles anew."""
    epoch, position = divmod(index * config.scenes, total - config.scenes + 1)
    order = np.random.default_rng([config.seed, epoch]).permutation(total)
    return np.sort(order[position : position + config.scenes])


def batch_rng(config: BatchConfig, index: int) -> np.random.Generator:
    """What else is drawn for batch number `index`."""
    return np.random.default_rng([config.seed, index, 1])


def encode_inputs(batch: Batch) -> Batch:
    """What a model's encode takes, of the arrays of a dataset."""
    batch = {**batch, "clearance_field": batch["clearance"]}
    return {name: batch[name] for name in INPUTS}


def mirror(batch: Batch) -> None:
    """Reflect scenes and trajectories in the x axis, in place; a heading changes its sign too."""
    height = batch["cost_map"].shape[-2]
    for name in ("cost_map", "clearance", "cost_to_go"):
        batch[name] = np.ascontiguousarray(np.flip(batch[name], -2))
    geometry = batch["map_geometry"]
    geometry[:, 1] = -(geometry[:, 1] + height * geometry[:, 2])
    for name, fields in (("x_curr", 3), ("x_goal", 2), ("states", 3)):
        dim = batch[name].shape[-1] // fields
        batch[name] *= reflection(dim, fields=fields)


def batches(dataset: SceneDataset, config: BatchConfig, indices: Iterable[int]) -> Generator[Batch]:
    """The batches of these numbers."""
    return prefetched(partial(draw_batch, dataset, config), indices)


def prefetched(draw: Callable[[int], Batch], indices: Iterable[int]) -> Generator[Batch]:
    """What `draw` gives for each number, the next one prepared while the last is used."""
    with ThreadPoolExecutor(1) as pool:
        ahead = None
        for index in indices:
            ready, ahead = ahead, pool.submit(draw, index)
            if ready:
                yield ready.result()
        if ahead:
            yield ahead.result()
