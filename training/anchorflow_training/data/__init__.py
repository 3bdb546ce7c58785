"""Data of your own: trajectory files as torch datasets, and as scenes that the trainer reads."""

from anchorflow_training.data.statistics import TrajectoryStatistics
from anchorflow_training.data.synthetic import SyntheticTrajectoryDataset
from anchorflow_training.data.trajectory_dataset import TrajectoryDataset, create_dataloader
from anchorflow_training.dataset import DatasetError

__all__ = [
    "DatasetError",
    "SyntheticTrajectoryDataset",
    "TrajectoryDataset",
    "TrajectoryStatistics",
    "create_dataloader",
]
