"""Small runs of every planner that learns from driving logs, which train in seconds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import tiny_diffusiondrive
import tiny_wote
from exported_bundles import SENSING

from anchorflow_models.futures import FuturesConfig
from anchorflow_models.goalflow import GoalFlowConfig
from anchorflow_training.batches import MirroredBatchConfig, SampledBatchConfig
from anchorflow_training.config import HeldOutConfig
from anchorflow_training.driving.augmentation import AugmentationConfig
from anchorflow_training.driving.diffusiondrive_objective import DiffusionDriveObjectiveConfig
from anchorflow_training.driving.diffusiondrive_run import DiffusionDriveRunConfig
from anchorflow_training.driving.futures_run import FuturesRunConfig
from anchorflow_training.driving.goalflow_objective import GoalFlowObjectiveConfig
from anchorflow_training.driving.goalflow_run import GoalFlowRunConfig
from anchorflow_training.driving.labels import CLASSES
from anchorflow_training.driving.wote_run import WoteRunConfig

COMMON: dict[str, Any] = {
    "steps": 3,
    "warmup": 0,
    "report_every": 1,
    "checkpoint_every": 2,
    "tensorboard": False,
    "accelerator": "cpu",
    "evaluation": HeldOutConfig(held_out=1, scenes=1),
}
GOALFLOW = GoalFlowRunConfig(
    **COMMON,
    learning_rate=3e-3,
    batch=SampledBatchConfig(scenes=3, samples=4),
    model=GoalFlowConfig(goals=16, picked=5, width=32, channels=8, feature_channels=4),
    objective=GoalFlowObjectiveConfig(scored=12),
)
SENSORS = replace(
    GOALFLOW,
    model=replace(SENSING, bev=GoalFlowConfig().bev, num_steps=8),
    augmentation=AugmentationConfig(moved=0.0),
)
FUTURES = FuturesRunConfig(
    **COMMON,
    learning_rate=3e-3,
    batch=MirroredBatchConfig(scenes=3),
    model=FuturesConfig(width=16, map_channels=4),
)
WOTE = WoteRunConfig(
    **COMMON,
    batch=MirroredBatchConfig(scenes=2),
    model=replace(tiny_wote.TINY, semantic_classes=len(CLASSES)),
)
DIFFUSIONDRIVE = DiffusionDriveRunConfig(
    **COMMON,
    batch=MirroredBatchConfig(scenes=2),
    model=replace(tiny_diffusiondrive.TINY, classes=len(CLASSES), direction=True),
    objective=DiffusionDriveObjectiveConfig(judged=6, group=2),
)
RUNS = {
    "goalflow": GOALFLOW,
    "goalflow on sensors": SENSORS,
    "futures": FUTURES,
    "wote": WOTE,
    "diffusiondrive": DIFFUSIONDRIVE,
}
AGENTS = {"diffusiondrive": 30}
"""How many agents a planner learns to find, if not 4."""
