"""Train DiffusionDriveV2 on driving logs with simulated sensors, stage by stage."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from anchorflow_models.diffusiondrive import DiffusionDriveConfig, DiffusionDriveV2
from anchorflow_models.diffusiondrive.config import POSES
from anchorflow_models.diffusiondrive.scorers import pdm_score
from anchorflow_training.batches import Batch, BatchConfig, batch_scenes
from anchorflow_training.checkpoint import load_checkpoint
from anchorflow_training.config import JudgeConfig, RunConfig
from anchorflow_training.curve import Row
from anchorflow_training.driving.anchor_scores import read_anchors, trajectory_anchors
from anchorflow_training.driving.diffusiondrive_objective import (
    DiffusionDriveObjective,
    DiffusionDriveObjectiveConfig,
    denoised,
)
from anchorflow_training.driving.pdm_judge import PdmJudge
from anchorflow_training.driving.semantic_bev import CLASSES
from anchorflow_training.driving.sensor_windows import open_sensor_windows
from anchorflow_training.driving.wote_run import sensor_sizes
from anchorflow_training.pretrained import load_resnet
from anchorflow_training.restore import restore_model
from anchorflow_training.run import TrainingRun
from anchorflow_training.settings import ConfigError, setting


@dataclass(frozen=True)
class DiffusionDriveRunConfig(RunConfig):
    """A run of one of the stages of `DiffusionDriveObjective`."""

    planner: ClassVar[str] = "diffusiondrive"

    learning_rate: float = 3e-4
    # Left is not right for anchors that were clustered.
    batch: BatchConfig = field(default_factory=lambda: BatchConfig(scenes=8, mirror=False))
    evaluation: JudgeConfig = field(default_factory=JudgeConfig)
    model: DiffusionDriveConfig = field(default_factory=DiffusionDriveConfig)
    objective: DiffusionDriveObjectiveConfig = field(default_factory=DiffusionDriveObjectiveConfig)
    before: str | None = setting(None, "Checkpoint of the stage before, to begin with.")
    anchors: str | None = setting(
        None, "File of anchors [K, T, 3] (.npy) instead of clustered ones."
    )
    resnet: str | None = setting(None, "Folder of ResNet weights to begin with.")


def diffusiondrive_settings(_logs: Sequence[Path]) -> Mapping[str, Any]:
    """What logs fix of the model: the classes of the semantic BEV that is drawn of them."""
    return {"classes": len(CLASSES)}


class DiffusionDriveRun(TrainingRun):
    """windows: with what sensors tell of them; the last are held out"""

    def __init__(self, config: DiffusionDriveRunConfig, logs: Sequence[Path], out: Path) -> None:
        if config.batch.mirror:
            raise ConfigError("batch.mirror: expected false: a picture of the left is not right")
        stage = config.objective.stage
        if stage != "imitation" and config.before is None:
            raise ConfigError(f"before: expected a checkpoint to begin {stage} with, got none")
        self.config, self.logs = config, logs
        self.windows = open_sensor_windows(logs, sensor_sizes(config.model.backbone))
        self.judge = PdmJudge(logs, self.windows.log)
        self.count = len(self.windows) - config.evaluation.held_out
        if self.count < config.batch.scenes:
            raise ConfigError(
                f"batch.scenes: expected at most {self.count}, the windows of the logs less "
                f"evaluation.held_out, got {config.batch.scenes}"
            )
        super().__init__(config, out)

    def begin(self, model: DiffusionDriveV2) -> None:
        """The weights of the stage before; or anchors, and a backbone that has seen pictures."""
        config, count = self.config, self.config.model.anchors
        if config.before:
            saved = load_checkpoint(Path(config.before))
            if saved.planner != config.planner:
                raise ConfigError(
                    f"before: expected a checkpoint of {config.planner}, got one of {saved.planner}"
                )
            before = restore_model(saved)
            if before.config != config.model:
                raise ConfigError(f"before: {config.before}: its model is of another configuration")
            model.load_state_dict(before.state_dict())
            return
        anchors = (
            read_anchors(Path(config.anchors), count=count, steps=POSES)
            if config.anchors
            else trajectory_anchors(
                self.windows.numbers["future"][: self.count], count=count, seed=config.batch.seed
            )
        )
        model.anchors.copy_(torch.from_numpy(anchors[..., :2]))
        if config.resnet:
            load_resnet(model.perception.backbone, Path(config.resnet))

    def new_objective(self, model: DiffusionDriveV2) -> DiffusionDriveObjective:
        return DiffusionDriveObjective(model, self.config.objective, self.judge)

    def stream(self, indices: Iterable[int]) -> Generator[Batch]:
        for index in indices:
            yield self.batch(batch_scenes(self.count, self.config.batch, index))

    def batch(self, windows: NDArray[np.integer]) -> Batch:
        """What the objective takes of these windows."""
        return {**self.windows.batch(windows), "window": windows.astype(np.int64)}

    @property
    def data(self) -> dict[str, Any]:
        return {"windows": self.count, "logs": len(self.logs), "sensors": "simulated"}

    @property
    def evaluates(self) -> bool:
        return self.config.evaluation.held_out > 0

    def evaluate(self, model: DiffusionDriveV2) -> tuple[Row, None]:
        """PDMS on windows that are held out, by who chooses: see `choices`."""
        held = np.arange(self.count, len(self.windows))
        picked = np.linspace(0, len(held) - 1, self.config.evaluation.scenes).astype(int)
        rows = [self._judged(model, int(window)) for window in held[np.unique(picked)]]
        return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}, None

    def _judged(self, model: DiffusionDriveV2, window: int) -> Row:
        device = model.anchors.device
        batch = {
            name: torch.from_numpy(array).to(device)
            for name, array in self.batch(np.array([window])).items()
        }
        generator = torch.Generator().manual_seed(window)
        row = choices(model, batch, self.judge, generator)
        learnt = "pdms_by_class" if self.config.objective.stage == "imitation" else "pdms_by_fine"
        return {"success": row[learnt], **row}


@torch.no_grad()
def choices(
    model: DiffusionDriveV2,
    batch: Mapping[str, torch.Tensor],
    judge: PdmJudge,
    generator: torch.Generator,
) -> Row:
    """What one window's candidates are worth, and what each way to choose among them finds.

    pdms_by_class: of the likeliest of those denoised; pdms_by_coarse, pdms_by_fine: by the scorers
    pdms_of_the_best: of all candidates, and pdms_of_the_best_plain of those without diversity noise
    spread_m, spread_plain_m: of the candidates' ends, with diversity noise and without
    """
    config, device = model.config, model.anchors.device
    scene = model.perception(batch["camera"], batch["lidar"], batch["ego_status"]).scene
    count = config.anchors * config.groups
    noise = torch.randn(1, count, POSES, 2, generator=generator).to(device)
    diversity = torch.randn(1, count, config.variants, 2, generator=generator).to(device)
    diversity[:, :, 0] = 0.0
    made = denoised(model, scene, noise)
    candidates = model.candidates(made.trajectories, diversity)
    coarse = model.coarse_scorer(candidates, scene)
    best = coarse.scores[0].argsort(descending=True)[: config.keep]
    fine = model.fine_scorer(candidates[:, best], coarse.features[:, best], scene)[-1]
    worth = pdm_score(judge(batch["window"], candidates))[0]
    plain = torch.arange(count) * config.variants
    ends = candidates[0, :, -1, :2].cpu()
    return {
        "pdms_by_class": float(worth[plain[int(made.logits[0].argmax())]]),
        "pdms_by_coarse": float(worth[int(best[0])]),
        "pdms_by_fine": float(worth[int(best[int(fine.scores[0].argmax())])]),
        "pdms_of_the_best": float(worth.max()),
        "pdms_of_the_best_plain": float(worth[plain].max()),
        "spread_m": float(ends.std(0).norm()),
        "spread_plain_m": float(ends[plain].std(0).norm()),
    }
