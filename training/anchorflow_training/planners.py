"""How each planner is trained, by its name in the registry of planners: a line a planner."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from anchorflow_driving.log import open_logs
from anchorflow_models.registry import UNNAMED
from anchorflow_training.config import RunConfig, TrainerConfig
from anchorflow_training.dataset import open_dataset
from anchorflow_training.driving.diffusiondrive_run import (
    DiffusionDriveRun,
    DiffusionDriveRunConfig,
)
from anchorflow_training.driving.futures_run import FuturesRun, FuturesRunConfig
from anchorflow_training.driving.goalflow_run import (
    GoalFlowRun,
    GoalFlowRunConfig,
    open_goalflow,
)
from anchorflow_training.driving.windows import open_windows
from anchorflow_training.driving.wote_run import WoteRun, WoteRunConfig
from anchorflow_training.settings import PLANNER, ConfigError, text_in
from anchorflow_training.trainer import CFMTrainer
from anchorflow_training.v2x.dataset import open_pairs
from anchorflow_training.v2x.run import V2XRun, V2XRunConfig


@dataclass(frozen=True)
class Training:
    """What `anchorflow train` needs of a planner.

    config: of a run, in which the planner has its name
    open_data: the folder to train on
    run: a `TrainingRun` of a configuration, the data and the folder of the run
    """

    config: type[RunConfig]
    open_data: Callable[[Path], Any]
    run: type[Any]


TRAININGS: Mapping[str, Training] = {
    training.config.planner: training
    for training in (
        Training(TrainerConfig, open_dataset, CFMTrainer),
        Training(GoalFlowRunConfig, open_goalflow, GoalFlowRun),
        Training(WoteRunConfig, open_logs, WoteRun),
        Training(DiffusionDriveRunConfig, open_logs, DiffusionDriveRun),
        Training(V2XRunConfig, open_pairs, V2XRun),
        Training(FuturesRunConfig, open_windows, FuturesRun),
    )
}


def training_of(planner: str | None, file: Path | None = None) -> Training:
    """How the planner of this name is trained; without one it is the file's, or else FlowMP.

    Raises `ConfigError` if there is no such planner, or no such file.
    """
    name = planner or (text_in(file, PLANNER) if file else None) or UNNAMED
    if name not in TRAININGS:
        raise ConfigError(f"planner: expected one of {', '.join(TRAININGS)}, got {name!r}")
    return TRAININGS[name]
