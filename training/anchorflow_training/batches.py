"""Training batches: a few scenes, many samples of each, so that a map is encoded once for many.

Batch i depends on the seed and on i alone; a run that resumes sees what it would have seen.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.dataset import SceneDataset, own_time_states
from anchorflow_training.settings import ConfigError, setting

SIGNS = np.array([1.0, -1.0, -1.0], np.float32)  # of x, y and heading


def reflection(dim: int, *, fields: int = 1) -> NDArray[np.float32]:
    """Signs [fields * D] that reflect as many fields of D numbers: 3 for p, v, a."""
    return np.tile(SIGNS[:dim], fields)


Batch = dict[str, NDArray[Any]]

# The arguments of a model's `encode`.
INPUTS = (
    "cost_map",
    "map_geometry",
    "clearance_field",
    "x_curr",
    "x_goal",
    "w_style",
    "limits",
)


@dataclass(frozen=True)
class BatchConfig:
    """scenes: B"""

    scenes: int = setting(16, "Scenes a batch.", ge=1)
    seed: int = setting(0, "Of weights, batches and noise.", ge=0)

    @property
    def per_scene(self) -> int:
        """N, what is learnt of each scene."""
        return 1


@dataclass(frozen=True)
class SampledBatchConfig(BatchConfig):
    """samples: N a scene (each trajectory is used samples / M times)"""

    samples: int = setting(32, "Samples a scene.", ge=1)

    @property
    def per_scene(self) -> int:
        return self.samples


@dataclass(frozen=True)
class MirroredBatchConfig(BatchConfig):
    """mirror: whether half of the batches are reflected"""

    mirror: bool = setting(True, "Reflect half of the batches; false where left is not right.")


@dataclass(frozen=True)
class FlowBatchConfig(MirroredBatchConfig, SampledBatchConfig):
    """Samples of scenes, or of their reflections."""


def draw_batch(dataset: SceneDataset, config: FlowBatchConfig, index: int) -> Batch:
    """Batch number `index`: the inputs of encode [B, ...] and of `FlowObjective`.

    states, prior_mean: [B, N, T, S], each with the route that it follows [B, N]
    starts: [B, N, R], what each trajectory began with, if the dataset has it
    sample_weights: [B, N], weights in the loss, if the dataset has a quality
    """
    batch = dataset.batch(batch_scenes(len(dataset), config, index))
    rng = batch_rng(config, index)
    if rng.random() < 0.5 and config.mirror:
        mirror(batch)
    count = batch["states"].shape[1]
    picked = np.stack(
        [rng.permutation(np.resize(np.arange(count), config.samples)) for _ in batch["states"]]
    )
    states, durations, route = (
        np.take_along_axis(batch[name], _like(picked, batch[name]), 1)
        for name in ("states", "durations", "route")
    )
    drawn = encode_inputs(batch) | {
        "states": own_time_states(states, durations),
        "prior_mean": prior_means(batch, route),
        "route": route.astype(np.int64),
    }
    if "starts" in batch:
        drawn["starts"] = np.take_along_axis(batch["starts"], picked[..., None], 1)
    if dataset.mean_quality is not None:
        # Their mean is 1 over the dataset, so that they leave the size of a step alone.
        quality = np.take_along_axis(batch["quality"], picked, 1)
        drawn["sample_weights"] = (quality / dataset.mean_quality).astype(np.float32)
    return drawn


def prior_means(batch: Batch, route: NDArray[Any]) -> NDArray[np.float32]:
    """[B, N, T, S]: the states along the route that each sample follows [B, N]."""
    return np.take_along_axis(batch["route_states"], route[..., None, None].astype(np.int64), 1)


def dealt_routes(batch: Batch, samples: int) -> NDArray[np.int64]:
    """[B, N]: the routes of each scene in turn, as a service deals them out."""
    counts = batch["route_states"].any((2, 3)).sum(1)
    return np.arange(samples) % np.maximum(counts, 1)[:, None]


def _like(picked: NDArray[Any], values: NDArray[Any]) -> NDArray[Any]:
    return picked.reshape(*picked.shape, *[1] * (values.ndim - 2))


def batch_scenes(total: int, config: BatchConfig, index: int) -> NDArray[np.int64]:
    """Which of `total` scenes batch number `index` shows, in order; every epoch shuffles anew."""
    epoch, position = divmod(index * config.scenes, total - config.scenes + 1)
    order = np.random.default_rng([config.seed, epoch]).permutation(total)
    return np.sort(order[position : position + config.scenes])


def batch_rng(config: BatchConfig, index: int) -> np.random.Generator:
    """What else is drawn for batch number `index`."""
    return np.random.default_rng([config.seed, index, 1])


def encode_inputs(batch: Batch) -> Batch:
    """Return the arguments of a model's `encode` from the arrays of a dataset."""
    batch = {**batch, "clearance_field": batch["clearance"]}
    return {name: batch[name] for name in INPUTS}


def mirror(batch: Batch) -> None:
    """Reflect scenes and trajectories in the x axis, in place; a heading changes its sign too."""
    height = batch["cost_map"].shape[-2]
    for name in ("cost_map", "clearance"):
        batch[name] = np.ascontiguousarray(np.flip(batch[name], -2))
    geometry = batch["map_geometry"]
    geometry[:, 1] = -(geometry[:, 1] + height * geometry[:, 2])
    for name, fields in (("x_curr", 3), ("x_goal", 2), ("states", 3)):
        dim = batch[name].shape[-1] // fields
        batch[name] *= reflection(dim, fields=fields)
    batch["route_states"][..., :-1] *= reflection(dim, fields=3)
    if "starts" in batch:
        signs = np.repeat(reflection(dim), (batch["starts"].shape[-1] - 1) // dim)
        batch["starts"][..., :-1] *= signs


def prefetched(
    draw: Callable[[int], Batch], indices: Iterable[int], *, threads: int = 1
) -> Generator[Batch]:
    """Yield `draw` of each number; `threads` batches are prepared while the last one is used."""
    ahead: deque[Future[Batch]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for index in indices:
            ahead.append(pool.submit(draw, index))
            if len(ahead) > threads:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()


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
