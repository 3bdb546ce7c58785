"""Data of your own: trajectory files as torch datasets, and as scenes that the trainer reads."""

from anchorflow_training.data.statistics import TrajectoryStatistics as TrajectoryStatistics
from anchorflow_training.data.synthetic import (
    SyntheticTrajectoryDataset as SyntheticTrajectoryDataset,
)
from anchorflow_training.data.trajectory_dataset import (
    TrajectoryDataset as TrajectoryDataset,
    create_dataloader as create_dataloader,
)
from anchorflow_training.dataset import DatasetError as DatasetError
