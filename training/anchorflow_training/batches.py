"""Training batches: a few scenes, many samples of each, so that a map is encoded once for many.

Batch i depends on the seed and on i alone; a run that resumes sees what it would have seen.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.dataset import SceneDataset

Batch = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class BatchConfig:
    """scenes: B; samples: N a scene (each trajectory is used samples / M times)."""

    scenes: int = 16
    samples: int = 32
    seed: int = 0


def draw_batch(dataset: SceneDataset, config: BatchConfig, step: int) -> Batch:
    """The encode inputs [B, ...], states [B, N, T, S] and the seed that the noise is drawn with."""
    epoch, position = divmod(step * config.scenes, len(dataset) - config.scenes + 1)
    order = np.random.default_rng([config.seed, epoch]).permutation(len(dataset))
    batch = dataset.batch(np.sort(order[position : position + config.scenes]))
    rng = np.random.default_rng([config.seed, step, 1])
    if rng.random() < 0.5:
        mirror(batch)
    states = batch["states"]
    chosen = [rng.permutation(np.resize(np.arange(states.shape[1]), config.samples)) for _ in states]
    batch["states"] = np.take_along_axis(states, np.stack(chosen)[..., None, None], 1)
    batch["clearance_field"] = batch.pop("clearance")
    return batch


def mirror(batch: Batch) -> None:
    """Reflect scenes and trajectories in the x axis, in place; a third dimension turns its sign too."""
    height = batch["cost_map"].shape[-2]
    for name in ("cost_map", "clearance", "cost_to_go"):
        batch[name] = np.ascontiguousarray(np.flip(batch[name], -2))
    geometry = batch["map_geometry"]
    geometry[:, 1] = -(geometry[:, 1] + height * geometry[:, 2])
    for name, fields in (("x_curr", 3), ("x_goal", 2), ("states", 3)):
        dim = batch[name].shape[-1] // fields
        batch[name] *= np.tile(np.float32([1.0, -1.0, -1.0])[:dim], fields)


def batches(dataset: SceneDataset, config: BatchConfig, steps: range) -> Iterator[Batch]:
    """The batches of these steps, the next one prepared while the last is used."""
    with ThreadPoolExecutor(1) as pool:
        ahead = None
        for step in steps:
            ready = ahead or pool.submit(draw_batch, dataset, config, step)
            ahead = pool.submit(draw_batch, dataset, config, step + 1)
            yield ready.result()
