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
    encode_inputs,
    mirror,
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
        """Batch number `index`: the inputs of encode, and z_0, z_1 [B, N, T, S].

        Half of the batches are reflected, as in the teacher's training, where `mirror` says so.
        """
        scenes, rng = (
            batch_scenes(self.bank.scenes, self.config, index),
            batch_rng(self.config, index),
        )
        mirrored = bool(rng.random() < 0.5 and self.config.mirror)
        pairs = [self._pairs(int(scene), rng) for scene in scenes]
        z_0, z_1 = (np.stack(states) for states in zip(*pairs, strict=True))
        batch = self.dataset.batch(scenes)
        if mirrored:
            mirror(batch)
            signs = reflection(self.dataset.dim, fields=3)
            z_0, z_1 = z_0 * signs, z_1 * signs
        return encode_inputs(batch) | {"z_0": z_0, "z_1": z_1}

    def _pairs(self, scene: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Some of a scene's pairs, again where it has fewer than a batch wants."""
        every = np.resize(rng.permutation(self.bank.samples), self.config.samples)
        z_0 = np.tensordot(self.bank.noise(scene)[every], self.starts, 1)
        return z_0, self.bank.ends(scene)[every]
