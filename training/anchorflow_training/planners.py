"""How each planner is trained, by its name in the registry of planners: a line a planner."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from anchorflow_models.registry import UNNAMED
from anchorflow_training.config import RunConfig, TrainerConfig
from anchorflow_training.config_file import model_settings, planner_in
from anchorflow_training.dataset import open_dataset
from anchorflow_training.driving.diffusiondrive_run import (
    DiffusionDriveRun,
    DiffusionDriveRunConfig,
    diffusiondrive_settings,
)
from anchorflow_training.driving.goalflow_run import (
    GoalFlowRun,
    GoalFlowRunConfig,
    goalflow_settings,
)
from anchorflow_training.driving.sensor_windows import open_logs
from anchorflow_training.driving.windows import open_windows
from anchorflow_training.driving.wote_run import WoteRun, WoteRunConfig, wote_settings
from anchorflow_training.run import TrainingRun
from anchorflow_training.settings import ConfigError
from anchorflow_training.trainer import CFMTrainer
from anchorflow_training.v2x import run as v2x
from anchorflow_training.v2x.config import V2XRunConfig
from anchorflow_training.v2x.dataset import open_pairs


@dataclass(frozen=True)
class Training:
    """What `anchorflow train` needs of a planner.

    config: of a run, in which the planner has its name
    open_data: the folder to train on
    model_settings: what those data fix of the model's configuration
    new_run: of a configuration, the data and the folder of the run
    """

    config: type[RunConfig]
    open_data: Callable[[Path], Any]
    model_settings: Callable[[Any], Mapping[str, Any]]
    new_run: Callable[[Any, Any, Path], TrainingRun]


TRAININGS: Mapping[str, Training] = {
    training.config.planner: training
    for training in (
        Training(TrainerConfig, open_dataset, model_settings, CFMTrainer),
        Training(GoalFlowRunConfig, open_windows, goalflow_settings, GoalFlowRun),
        Training(WoteRunConfig, open_logs, wote_settings, WoteRun),
        Training(DiffusionDriveRunConfig, open_logs, diffusiondrive_settings, DiffusionDriveRun),
        Training(V2XRunConfig, open_pairs, v2x.model_settings, v2x.V2XRun),
    )
}


def training_of(planner: str | None, file: Path | None = None) -> Training:
    """How the planner of this name is trained; without one it is the file's, or else FlowMP.

    Raises:
        ConfigError: there is no such planner, or no such file.
    """
    name = planner or (planner_in(file) if file else None) or UNNAMED
    if name not in TRAININGS:
        raise ConfigError(f"planner: expected one of {', '.join(TRAININGS)}, got {name!r}")
    return TRAININGS[name]
