"""The small networks that see, as the configuration files of `examples/` have them."""

from __future__ import annotations

from pathlib import Path

from anchorflow_training.driving.diffusiondrive_run import DiffusionDriveRunConfig
from anchorflow_training.driving.goalflow_run import GoalFlowRunConfig
from anchorflow_training.driving.wote_run import WoteRunConfig
from anchorflow_training.settings import layers

EXAMPLES = Path(__file__).parents[2] / "examples"
WOTE = layers(WoteRunConfig, {}, EXAMPLES / "wote-small.yaml").model
DIFFUSIONDRIVE = layers(DiffusionDriveRunConfig, {}, EXAMPLES / "diffusiondrive-small.yaml").model
GOALFLOW = layers(GoalFlowRunConfig, {}, EXAMPLES / "goalflow-sensors.yaml").model
BACKBONE = WOTE.backbone
