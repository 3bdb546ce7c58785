"""Runs on driving logs: held-out logs, and recorded or simulated sensors for all planners."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from statistics import fmean
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from anchorflow_driving.recorded_sensors import kinds_of, read_sensors
from anchorflow_models.transfuser import LIDAR_BEFORE, TransfuserConfig
from anchorflow_training.batches import (
    SIGNS,
    Batch,
    MirroredBatchConfig,
    batch_rng,
    batch_scenes,
    left_to_learn,
    reflection,
)
from anchorflow_training.config import HeldOutConfig, RunConfig
from anchorflow_training.driving.anchors import read_points, trajectory_anchors
from anchorflow_training.driving.pdm_judge import PdmJudge
from anchorflow_training.driving.sensor_windows import SensorSizes, disturb, open_sensor_windows
from anchorflow_training.pretrained import (
    BACKBONE,
    load_resnet,
    load_sight,
    measure_normalisation,
    sight_of,
)
from anchorflow_training.record import Row
from anchorflow_training.run import TrainingRun
from anchorflow_training.settings import check_fixed, other_default, setting

MEASURED = 2  # batches, for the statistics that weights of a bundle lack


class DrivingRun(TrainingRun):
    """A run on windows of driving logs; those from `count` on are held out.

    windows: have a length, and a `log` [W] by number

    Raises `ConfigError`.
    """

    config: Any
    windows: Any
    count: int

    def __init__(self, config: Any, windows: Any, out: Path, *, of: str) -> None:
        self.config, self.windows = config, windows
        self.count = left_to_learn(
            len(windows),
            of=of,
            held_out=config.evaluation.held_out,
            batch=config.batch,
            log=windows.log,
        )
        super().__init__(config, out)

    @property
    def data(self) -> dict[str, Any]:
        return {"windows": self.count, "logs": len(np.unique(self.windows.log[: self.count]))}

    @property
    def evaluates(self) -> bool:
        return self.config.evaluation.held_out > 0

    def evaluate(self, model: Any) -> tuple[Row, None]:
        """Return the means of `judged` over held-out windows, evenly spread."""
        last = len(self.windows) - 1
        picked = np.linspace(0, last - self.count, self.config.evaluation.scenes).astype(int)
        with torch.no_grad():
            rows = [self.judged(model, self.count + int(one)) for one in np.unique(picked)]
        return means(rows), None

    @abstractmethod
    def judged(self, model: Any, window: int) -> Row:
        """Return the scores of a model in one window, with a `success`; NaN: not counted."""


def means(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean of each figure over the rows in which it is no NaN; 0 if there are none."""
    counted = {name: [r[name] for r in rows if not math.isnan(r[name])] for name in rows[0]}
    return {name: fmean(values or [0.0]) for name, values in counted.items()}


@dataclass(frozen=True)
class SightRunConfig(RunConfig):
    """A run of a planner that sees by camera and LiDAR, or may."""

    begins_with: ClassVar = ("resnet",)

    resnet: str | None = setting(None, "Folder of ResNet weights to begin with.")
    lidar_before_lost: float = setting(
        0.1, "Share of the batches without the LiDAR of before.", ge=0, le=1
    )
    perception: str | None = setting(
        None, "Checkpoint of any planner that sees by the same parts, to begin with their weights."
    )
    frozen_perception: bool = setting(False, "Keep these parts as they begin: they do not learn.")
    sensor_noise: float = setting(0.0, "On pictures and sweeps; 1 is strong, 0 is none.", ge=0)

    @property
    def sight(self) -> TransfuserConfig | None:
        """The backbone that sees, if the planner has one."""
        return self.model.backbone


@dataclass(frozen=True)
class SensorRunConfig(SightRunConfig):
    """A run that learns from camera, LiDAR and ego status, and begins with anchors."""

    begins_with: ClassVar = ("anchors", *SightRunConfig.begins_with)

    learning_rate: float = other_default(RunConfig, "learning_rate", 3e-4)
    batch: MirroredBatchConfig = field(default_factory=lambda: MirroredBatchConfig(scenes=8))
    evaluation: HeldOutConfig = field(default_factory=HeldOutConfig)
    anchors: str | None = setting(
        None, "File of anchors [K, T, 3] (.npy) instead of clustered ones."
    )
    judges: int = setting(
        0, "Processes that score what the network proposes; 0: the run's own.", ge=0
    )


class SightRun(DrivingRun):
    """A run of a planner with parts that see, if it has them; its config is a `SightRunConfig`."""

    def _new_model(self) -> Any:
        model = super()._new_model()
        if self.config.frozen_perception:
            # Their normalisation neither.
            for part in sight_of(model).values():
                part.requires_grad_(False).eval()
        return model

    def begin_after(self, model: Any, weights: Mapping[str, torch.Tensor]) -> None:
        """Load those weights, and over them another planner's perception, if one is named."""
        super().begin_after(model, weights)
        self._load_perception(model)

    def load_sight(self, model: nn.Module) -> None:
        """Load the configured weights of perception, if there are any."""
        if self.config.resnet:
            load_resnet(sight_of(model)[BACKBONE], Path(self.config.resnet))
        self._load_perception(model)

    def _load_perception(self, model: nn.Module) -> None:
        """Load the configured perception, and measure statistics that weights may lack."""
        if self.config.perception:
            load_sight(sight_of(model), Path(self.config.perception))
        measure_normalisation(model, map(self.batch, range(MEASURED)))

    def spoil(self, batch: Batch, rng: np.random.Generator, *, luck: float) -> None:
        """Lose the LiDAR of before if luck, in [0, 1), is low, and add the configured noise."""
        if luck < self.config.lidar_before_lost:
            batch.pop(LIDAR_BEFORE, None)
        if self.config.sensor_noise:
            disturb(batch, rng, scale=self.config.sensor_noise)


class SensorRun(SightRun):
    """A run on windows with sensors; its config is a `SensorRunConfig` with a `model`."""

    def __init__(self, config: Any, logs: Sequence[Path], out: Path) -> None:
        self.logs = logs
        check_fixed(config.model, self.model_settings(logs), by="the logs")
        windows = open_sensor_windows(logs, SensorSizes.of(config.model.backbone))
        super().__init__(config, windows, out, of="the windows of the logs")

    @property
    def data(self) -> dict[str, Any]:
        sensors = kinds_of(map(read_sensors, self.logs))
        return {"windows": self.count, "logs": len(self.logs), "sensors": sensors}

    @cached_property
    def judge(self) -> PdmJudge:
        """The PDM judge of trajectories in the windows."""
        return PdmJudge(
            self.logs,
            self.windows.log,
            direction=self.scores_direction,
            processes=self.config.judges,
        )

    @property
    def scores_direction(self) -> bool:
        """Whether driving direction compliance is one of the scores that are learnt."""
        return False

    def window_batch(self, windows: NDArray[np.integer], *, mirrored: bool = False) -> Batch:
        """Return the objective's inputs in these windows, or in their reflections."""
        return {
            **self.windows.batch(windows, mirrored=mirrored),
            "window": windows.astype(np.int64),
            "signs": np.tile(reflection(3) if mirrored else np.ones_like(SIGNS), (len(windows), 1)),
        }

    def batch(self, index: int) -> Batch:
        sizes, rng = self.config.batch, batch_rng(self.config.batch, index)
        luck = rng.random(2)
        mirrored = sizes.mirror and bool(luck[0] < 0.5)
        batch = self.window_batch(batch_scenes(self.count, sizes, index), mirrored=mirrored)
        self.spoil(batch, rng, luck=luck[1])
        return batch

    def judged(self, model: Any, window: int) -> Row:
        arrays = self.window_batch(np.array([window]))
        batch = {name: torch.from_numpy(array) for name, array in arrays.items()}
        return self.judged_batch(model, self.fabric.to_device(batch))

    @abstractmethod
    def judged_batch(self, model: Any, batch: dict[str, torch.Tensor]) -> Row:
        """Return the scores of a model in one window, its `batch` on the model's device."""

    def first_anchors(self, *, count: int, steps: int) -> torch.Tensor:
        """Return anchors [K, T, 3] to begin with: the configured file's, or clustered ones."""
        return self.first_poses("anchors", count=count, steps=steps)

    def first_poses(self, setting: str, *, count: int, steps: int) -> torch.Tensor:
        """Return trajectories [K, T, 3] of the file that a setting names, or clustered ones."""
        if file := getattr(self.config, setting):
            shape = (count, steps, 3)
            return torch.from_numpy(read_points(Path(file), shape, setting=setting))
        numbers, learnt = self.windows.numbers, slice(self.count)
        examples = numbers["future"][learnt][numbers["is_example"][learnt] > 0][:, :steps]
        return torch.from_numpy(
            trajectory_anchors(examples, count=count, seed=self.config.batch.seed)
        )
