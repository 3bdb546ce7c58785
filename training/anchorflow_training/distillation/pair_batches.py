"""Batches of a teacher's pairs: a few scenes, and where noise begins and ends in each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.batches import (
    Batch,
    BatchConfig,
    batch_rng,
    batch_scenes,
    dealt_routes,
    encode_inputs,
    mirror,
    prior_means,
)
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.pairs import PairBank
from anchorflow_training.reflection import reflection

FloatArray = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PairBatches:
    """starts: [R, T, S], the normalised state of each unit of noise"""

    dataset: SceneDataset
    bank: PairBank
    starts: FloatArray
    config: BatchConfig

    def draw(self, index: int) -> Batch:
        """Batch number `index`: the inputs of encode; z_0, z_1 and prior_mean [B, N, T, S].

        Half of the batches are reflected, as in the teacher's training, where `mirror` says so.
        """
        scenes, rng = (
            batch_scenes(self.bank.scenes, self.config, index),
            batch_rng(self.config, index),
        )
        mirrored = bool(rng.random() < 0.5 and self.config.mirror)
        samples = self.bank.samples
        # Some of a scene's pairs, again where it has fewer than a batch wants.
        picked = np.stack([np.resize(rng.permutation(samples), self.config.samples) for _ in scenes])
        noise = np.stack([self.bank.noise(int(scene)) for scene in scenes])
        ends = np.stack([self.bank.ends(int(scene)) for scene in scenes])
        z_0 = np.tensordot(np.take_along_axis(noise, picked[..., None], 1), self.starts, 1)
        z_1 = np.take_along_axis(ends, picked[..., None, None], 1)
        batch = self.dataset.batch(scenes)
        z_0[..., -1] *= (batch["limits"][:, 3] <= 0)[:, None, None]
        if mirrored:
            mirror(batch)
            signs = np.append(reflection(self.dataset.dim, fields=3), np.float32(1.0))
            z_0, z_1 = z_0 * signs, z_1 * signs
        route = np.take_along_axis(dealt_routes(batch, samples), picked, 1)
        return encode_inputs(batch) | {
            "z_0": z_0,
            "z_1": z_1,
            "prior_mean": prior_means(batch, route),
        }
