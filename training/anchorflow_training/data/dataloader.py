"""Batches of a trajectory dataset, in torch."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch
from torch.utils.data import DataLoader

from anchorflow_training.data.trajectory_dataset import Sample, TrajectoryDataset, stacked
from anchorflow_training.data.trajectory_statistics import FIELDS, TrajectoryStatistics


def create_dataloader(
    dataset: TrajectoryDataset,
    batch_size: int,
    *,
    shuffle: bool = True,
    seed: int = 0,
    normalise: bool = False,
    drop_last: bool = False,
    workers: int = 0,
) -> DataLoader[Sample]:
    """Batches of `batch_size` samples: what a sample of the dataset names, as tensors [B, ...].

    seed: the order of every epoch follows from it and from the epochs before
    normalise: positions, velocities and accelerations by `dataset.statistics`
    workers: processes that read ahead; each opens the file for itself
    """
    return DataLoader(
        dataset,
        batch_size,
        shuffle=shuffle,
        generator=torch.Generator().manual_seed(seed),
        collate_fn=partial(_collate, dataset.statistics if normalise else None),
        num_workers=workers,
        drop_last=drop_last,
    )


def _collate(statistics: TrajectoryStatistics | None, batch: Any) -> Sample:
    batch = stacked(batch)
    if statistics is None:
        return batch
    scaled = {
        name: torch.from_numpy(getattr(statistics, name).normalise(batch[name].numpy()))
        for name in FIELDS
    }
    return batch | scaled
