"""Batches of a teacher's pairs: a few scenes, and where noise begins and ends in each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.batches import (
    Batch,
    FlowBatchConfig,
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
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.route_splines import LEAST_WAY

FloatArray = NDArray[np.float32]

PAIRED = ("z_0", "z_1", "prior_mean", "reference_s")
"""What a batch of pairs has beside the inputs of encode."""


@dataclass(frozen=True, eq=False)
class PairBatches:
    """starts: [R, T, S], the normalised state of each unit of noise"""

    dataset: SceneDataset
    bank: PairBank
    starts: FloatArray
    config: FlowBatchConfig

    def draw(self, index: int) -> Batch:
        """Batch number `index`: the inputs of encode; PAIRED.

        z_0, z_1, prior_mean: [B, N, T, S]; reference_s: [B] s, as of `Scene`

        Half of the batches are reflected, as in the teacher's training, where `mirror` says so.
        """
        scenes = batch_scenes(self.bank.scenes, self.config, index)
        rng = batch_rng(self.config, index)
        mirrored = bool(rng.random() < 0.5 and self.config.mirror)
        samples = self.bank.samples
        # Some of a scene's pairs, again where it has fewer than a batch wants.
        picked = np.stack(
            [np.resize(rng.permutation(samples), self.config.samples) for _ in scenes]
        )
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
            "reference_s": reference_times(batch),
        }


def reference_times(batch: Batch) -> FloatArray:
    """[B] s in which each scene's shortest route can be driven, by the length of its spline."""
    places = batch["route_states"][:, 0, :, :2]
    ways = np.linalg.norm(np.diff(places, axis=1), axis=-1).sum(-1)
    times = [
        MotionLimits(v_max, a_max).least_time(max(way, LEAST_WAY))
        for way, (v_max, a_max, *_) in zip(ways.tolist(), batch["limits"].tolist(), strict=True)
    ]
    return np.array(times, np.float32)
