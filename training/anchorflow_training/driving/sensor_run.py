"""What every run on driving logs with simulated sensors has, whichever planner learns there."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from anchorflow_models.transfuser import LIDAR_BEFORE
from anchorflow_training.batches import (
    Batch,
    MirroredBatchConfig,
    batch_rng,
    batch_scenes,
    prefetched,
)
from anchorflow_training.config import HeldOutConfig, RunConfig
from anchorflow_training.curve import Row
from anchorflow_training.driving.anchor_scores import read_anchors, trajectory_anchors
from anchorflow_training.driving.pdm_judge import PdmJudge
from anchorflow_training.driving.sensor_noise import disturb
from anchorflow_training.driving.sensor_windows import SensorSizes, open_sensor_windows
from anchorflow_training.held_out import left_to_learn, means
from anchorflow_training.pretrained import BACKBONE, load_resnet, load_sight, sight_of
from anchorflow_training.reflection import SIGNS, reflection
from anchorflow_training.run import TrainingRun
from anchorflow_training.settings import check_fixed, setting


@dataclass(frozen=True)
class SensorRunConfig(RunConfig):
    """A run that learns from camera, LiDAR and ego status, and begins with anchors."""

    begins_with: ClassVar = ("anchors", "resnet")

    learning_rate: float = 3e-4
    batch: MirroredBatchConfig = field(default_factory=lambda: MirroredBatchConfig(scenes=8))
    evaluation: HeldOutConfig = field(default_factory=HeldOutConfig)
    anchors: str | None = setting(
        None, "File of anchors [K, T, 3] (.npy) instead of clustered ones."
    )
    resnet: str | None = setting(None, "Folder of ResNet weights to begin with.")
    lidar_before_lost: float = setting(
        0.1, "Share of the batches without the LiDAR of before.", least=0, most=1
    )
    perception: str | None = setting(
        None, "Checkpoint of any planner that sees by the same parts, to begin with their weights."
    )
    frozen_perception: bool = setting(False, "Keep these parts as they begin: they do not learn.")
    sensor_noise: float = setting(0.0, "On pictures and sweeps; 1 is strong, 0 is none.", least=0)
    judges: int = setting(
        0, "Processes that score what the network proposes; 0: the run's own.", least=0
    )
    loaders: int = setting(1, "Threads that prepare batches ahead.", least=1)


class SensorRun(TrainingRun):
    """windows: with what sensors tell of them; those from `count` on are held out

    Raises:
        ConfigError: names `batch.scenes` or `evaluation.held_out`.
    """

    config: Any
    """A `SensorRunConfig` with the `model` of the planner."""

    def __init__(self, config: Any, logs: Sequence[Path], out: Path) -> None:
        self.config, self.logs = config, logs
        check_fixed(config.model, self.model_settings(logs), by="the logs")
        self.windows = open_sensor_windows(logs, SensorSizes.of(config.model.backbone))
        self.count = left_to_learn(
            len(self.windows),
            of="the windows of the logs",
            held_out=config.evaluation.held_out,
            batch=config.batch,
            log=self.windows.log,
        )
        super().__init__(config, out)

    def _new_model(self) -> Any:
        model = super()._new_model()
        if self.config.frozen_perception:
            # Their normalisation neither.
            for part in sight_of(model).values():
                part.requires_grad_(False).eval()
        return model

    def begin_after(self, model: Any, weights: Mapping[str, torch.Tensor]) -> None:
        """Those weights, and over them another planner's perception, where one is named."""
        super().begin_after(model, weights)
        if self.config.perception:
            load_sight(sight_of(model), Path(self.config.perception))

    @cached_property
    def judge(self) -> PdmJudge:
        """Of trajectories in the windows."""
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

    def batch(self, windows: NDArray[np.integer], *, mirrored: bool = False) -> Batch:
        """What the objective takes of these windows, or of their reflections."""
        return {
            **self.windows.batch(windows, mirrored=mirrored),
            "window": windows.astype(np.int64),
            "signs": np.tile(reflection(3) if mirrored else np.ones_like(SIGNS), (len(windows), 1)),
        }

    @abstractmethod
    def judged(self, model: Any, batch: dict[str, torch.Tensor]) -> Row:
        """What a model makes of one window, its `batch` on the model's device; has a `success`."""

    def first_anchors(self, *, count: int, steps: int) -> torch.Tensor:
        """[K, T, 3] to begin with: those of the configuration's file, or clustered ones."""
        anchors = (
            read_anchors(Path(self.config.anchors), count=count, steps=steps)
            if self.config.anchors
            else trajectory_anchors(self._examples(), count=count, seed=self.config.batch.seed)
        )
        return torch.from_numpy(anchors)

    def _examples(self) -> NDArray[np.float32]:
        """[M, T, 3] what may be imitated in the windows to learn from."""
        numbers, learnt = self.windows.numbers, slice(self.count)
        return numbers["future"][learnt][numbers["is_example"][learnt] > 0]

    def first_weights(self, model: nn.Module) -> None:
        """Those that have seen pictures, where the configuration names some."""
        sight = sight_of(model)
        if self.config.resnet:
            load_resnet(sight[BACKBONE], Path(self.config.resnet))
        if self.config.perception:
            load_sight(sight, Path(self.config.perception))

    def stream(self, indices: Iterable[int]) -> Generator[Batch]:
        return prefetched(self._numbered, indices, threads=self.config.loaders)

    def _numbered(self, index: int) -> Batch:
        sizes, rng = self.config.batch, batch_rng(self.config.batch, index)
        luck = rng.random(2)
        mirrored = sizes.mirror and bool(luck[0] < 0.5)
        batch = self.batch(batch_scenes(self.count, sizes, index), mirrored=mirrored)
        if luck[1] < self.config.lidar_before_lost:
            batch.pop(LIDAR_BEFORE, None)
        if self.config.sensor_noise:
            disturb(batch, rng, scale=self.config.sensor_noise)
        return batch

    @property
    def data(self) -> dict[str, Any]:
        return {"windows": self.count, "logs": len(self.logs), "sensors": "simulated"}

    @property
    def evaluates(self) -> bool:
        return self.config.evaluation.held_out > 0

    @torch.no_grad()
    def evaluate(self, model: Any) -> tuple[Row, None]:
        """The means over windows that are held out of what `judged` finds."""
        held = np.arange(self.count, len(self.windows))
        picked = np.linspace(0, len(held) - 1, self.config.evaluation.scenes).astype(int)
        rows = []
        for window in held[np.unique(picked)]:
            arrays = self.batch(np.array([window]))
            batch = {name: torch.from_numpy(array) for name, array in arrays.items()}
            rows.append(self.judged(model, self.fabric.to_device(batch)))
        return means(rows), None
