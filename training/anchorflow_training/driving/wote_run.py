"""Train WoTE on driving logs with simulated sensors."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from anchorflow_models.transfuser import TransfuserConfig
from anchorflow_models.wote import WoTE, WoteConfig
from anchorflow_training.batches import Batch, BatchConfig, batch_scenes
from anchorflow_training.config import JudgeConfig, RunConfig
from anchorflow_training.curve import Row
from anchorflow_training.driving.anchor_scores import (
    anchor_scores,
    pdms,
    read_anchors,
    trajectory_anchors,
)
from anchorflow_training.driving.sensor_windows import SensorSizes, open_sensor_windows
from anchorflow_training.driving.wote_objective import (
    WoteObjective,
    WoteObjectiveConfig,
    anchor_distances,
)
from anchorflow_training.pretrained import load_resnet
from anchorflow_training.run import TrainingRun
from anchorflow_training.settings import ConfigError, setting


@dataclass(frozen=True)
class WoteRunConfig(RunConfig):
    """A run that learns WoTE from driving logs."""

    planner: ClassVar[str] = "wote"

    learning_rate: float = 3e-4
    # Left is not right for anchors that were clustered.
    batch: BatchConfig = field(default_factory=lambda: BatchConfig(scenes=8, mirror=False))
    evaluation: JudgeConfig = field(default_factory=JudgeConfig)
    model: WoteConfig = field(default_factory=WoteConfig)
    objective: WoteObjectiveConfig = field(default_factory=WoteObjectiveConfig)
    anchors: str | None = setting(
        None, "File of anchors [K, T, 3] (.npy) instead of clustered ones."
    )
    resnet: str | None = setting(None, "Folder of ResNet weights to begin with.")


def wote_settings(_logs: Sequence[Path]) -> Mapping[str, Any]:
    """Logs fix nothing of the model: its sensors are drawn in the sizes that it wants."""
    return {}


def sensor_sizes(backbone: TransfuserConfig) -> SensorSizes:
    """Of what a backbone looks at."""
    return SensorSizes(
        backbone.image_height, backbone.image_width, backbone.lidar_size, backbone.lidar_range
    )


class WoteRun(TrainingRun):
    """windows: with what sensors tell of them; the last are held out

    pdm: [W, K, 5] sub-scores of the anchors
    """

    def __init__(self, config: WoteRunConfig, logs: Sequence[Path], out: Path) -> None:
        if config.batch.mirror:
            raise ConfigError("batch.mirror: expected false: a picture of the left is not right")
        self.config, self.logs = config, logs
        self.windows = open_sensor_windows(logs, sensor_sizes(config.model.backbone))
        self.count = len(self.windows) - config.evaluation.held_out
        if self.count < config.batch.scenes:
            raise ConfigError(
                f"batch.scenes: expected at most {self.count}, the windows of the logs less "
                f"evaluation.held_out, got {config.batch.scenes}"
            )
        super().__init__(config, out)
        # Those of the checkpoint, where there is one.
        self.pdm = anchor_scores(logs, self.model.anchors.cpu().numpy())

    def begin(self, model: WoTE) -> None:
        """Anchors, and a backbone that has seen pictures where there is one."""
        config, model_config = self.config, self.config.model
        anchors = (
            read_anchors(
                Path(config.anchors), count=model_config.anchors, steps=model_config.num_steps
            )
            if config.anchors
            else trajectory_anchors(
                self.windows.numbers["future"][: self.count],
                count=model_config.anchors,
                seed=config.batch.seed,
            )
        )
        model.set_anchors(torch.from_numpy(anchors))
        if config.resnet:
            load_resnet(model.backbone, Path(config.resnet))

    def new_objective(self, model: WoTE) -> WoteObjective:
        return WoteObjective(model, self.config.objective)

    def stream(self, indices: Iterable[int]) -> Generator[Batch]:
        for index in indices:
            yield self.batch(batch_scenes(self.count, self.config.batch, index))

    def batch(self, windows: NDArray[np.integer]) -> Batch:
        """What the objective takes of these windows."""
        return {**self.windows.batch(windows), "pdm": self.pdm[windows]}

    @property
    def data(self) -> dict[str, Any]:
        return {"windows": self.count, "logs": len(self.logs), "sensors": "simulated"}

    @property
    def evaluates(self) -> bool:
        return self.config.evaluation.held_out > 0

    def evaluate(self, model: WoTE) -> tuple[Row, None]:
        """How well the anchors of windows that are held out are chosen and refined.

        success: PDMS of the anchor with the best score, before its offset
        """
        held = np.arange(self.count, len(self.windows))
        picked = np.linspace(0, len(held) - 1, self.config.evaluation.scenes).astype(int)
        rows = [self._judged(model, int(window)) for window in held[np.unique(picked)]]
        return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}, None

    @torch.no_grad()
    def _judged(self, model: WoTE, window: int) -> dict[str, float]:
        device = model.anchors.device
        batch = {
            name: torch.from_numpy(array).to(device)
            for name, array in self.batch(np.array([window])).items()
        }
        seen = model.look(batch["camera"], batch["lidar"], batch["ego_status"])
        scored = model.score(seen.bev, seen.ego)
        refined = anchor_distances(scored["trajectories"][0], batch["future"])
        worth = pdms(self.pdm[window])
        # Whichever were kept, by the anchors that they are nearest to before their offsets.
        plain = scored["trajectories"][0] - scored["offsets"][0]
        index = torch.cdist(plain.flatten(1), model.anchors.flatten(1)).argmin(-1).cpu().numpy()
        return {
            "success": float(worth[index[int(scored["scores"][0].argmax())]]),
            "pdms_by_imitation": float(worth[index[int(scored["im_rewards"][0].argmax())]]),
            "pdms_of_the_best": float(worth.max()),
            "best_ade_m": float(anchor_distances(model.anchors, batch["future"]).min()),
            "best_refined_ade_m": float(refined.min()),
        }
