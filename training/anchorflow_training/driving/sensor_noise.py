"""Pictures and sweeps as another camera and another LiDAR would show them."""

from __future__ import annotations

import numpy as np

from anchorflow_training.batches import Batch
from anchorflow_training.driving.sensor_windows import LIDAR_RANDOMISED, SWEEPS

GAIN, TINT, GRAIN = 0.15, 12.0, 8.0
"""Spread of brightness and colours; of what a colour is off by; at most, of single pixels."""
LOST = 0.3  # at most, of the cells of a sweep


def disturb(batch: Batch, rng: np.random.Generator, *, scale: float) -> None:
    """Change camera [B, 3, H, W] and sweeps [B, 1, H', H'] in place, each scene's by a luck of its
    own.

    scale: of the spreads and shares above
    """
    camera = batch["camera"]
    count = len(camera)
    by_colour = (count, 3, 1, 1)
    gain = 1 + scale * GAIN * (
        rng.standard_normal((count, 1, 1, 1))
        + rng.random((count, 1, 1, 1)) * rng.standard_normal(by_colour)
    )
    grain = scale * GRAIN * rng.random((count, 1, 1, 1), np.float32)
    seen = camera * gain + scale * TINT * rng.standard_normal(by_colour)
    seen += grain * rng.standard_normal(camera.shape, np.float32)
    batch["camera"] = np.rint(seen).clip(0, 255).astype(np.uint8)
    lost = min(1.0, scale * LOST) * rng.random((count, 1, 1, 1), np.float32)
    for name in (*SWEEPS, LIDAR_RANDOMISED):
        if name in batch:
            batch[name] = batch[name] * (rng.random(batch[name].shape, np.float32) >= lost)
