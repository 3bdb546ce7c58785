"""Train DiffusionDriveV2 on driving logs with recorded or simulated sensors, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import torch

from anchorflow_models.diffusiondrive import DiffusionDriveConfig, DiffusionDriveV2
from anchorflow_models.diffusiondrive.config import POSES
from anchorflow_models.sub_scores import pdm_score
from anchorflow_training.driving.diffusiondrive_objective import (
    DiffusionDriveObjective,
    DiffusionDriveObjectiveConfig,
    denoised,
)
from anchorflow_training.driving.driving_run import SensorRun, SensorRunConfig
from anchorflow_training.driving.labels import CLASSES
from anchorflow_training.driving.pdm_judge import PdmJudge
from anchorflow_training.driving.sensor_windows import sensors_of
from anchorflow_training.record import Row
from anchorflow_training.settings import ConfigError, setting


@dataclass(frozen=True)
class DiffusionDriveRunConfig(SensorRunConfig):
    """A run of one of the stages of `DiffusionDriveObjective`."""

    planner: ClassVar[str] = "diffusiondrive"
    begins_with: ClassVar = (*SensorRunConfig.begins_with, "vocabulary")

    model: DiffusionDriveConfig = field(default_factory=DiffusionDriveConfig)
    objective: DiffusionDriveObjectiveConfig = field(default_factory=DiffusionDriveObjectiveConfig)
    vocabulary: str | None = setting(
        None,
        "File of model.vocabulary fixed candidates [K, 8, 3] (.npy) instead of clustered ones.",
    )


class DiffusionDriveRun(SensorRun):
    """Learns to denoise anchors, or to score what was denoised."""

    config: DiffusionDriveRunConfig

    def __init__(self, config: DiffusionDriveRunConfig, logs: Sequence[Path], out: Path) -> None:
        stage = config.objective.stage
        if stage in ("scorers", "reinforcement") and config.before is None:
            raise ConfigError(f"before: expected a checkpoint to begin {stage} with, got none")
        super().__init__(config, logs, out)
        try:
            self.model.check_vocabulary()
        except ValueError as error:
            raise ConfigError(f"before: {config.before}: {error}") from error

    @staticmethod
    def model_settings(data: Sequence[Path]) -> Mapping[str, Any]:  # noqa: ARG004
        """The classes of the semantic BEV that is drawn."""
        return {"classes": len(CLASSES)}

    @property
    def scores_direction(self) -> bool:
        return self.config.model.direction

    def begin(self, model: DiffusionDriveV2) -> None:
        """Anchors, a vocabulary, and a backbone that has seen pictures where there is one."""
        anchors = self.first_anchors(count=self.config.model.anchors, steps=POSES)
        model.anchors.copy_(anchors[..., :2])
        if count := self.config.model.vocabulary:
            model.set_vocabulary(self.first_poses("vocabulary", count=count, steps=POSES))
        self.load_sight(model)

    def new_objective(self, model: DiffusionDriveV2) -> DiffusionDriveObjective:
        return DiffusionDriveObjective(model, self.config.objective, self.judge)

    def judged_batch(self, model: DiffusionDriveV2, batch: dict[str, torch.Tensor]) -> Row:
        """The window's candidates by who chooses among them: see `choices`."""
        generator = torch.Generator().manual_seed(int(batch["window"]))
        row = choices(model, batch, self.judge, generator)
        learnt = "pdms_by_class" if self.config.objective.stage == "imitation" else "pdms_by_fine"
        return {"success": row[learnt], **row}


def choices(
    model: DiffusionDriveV2,
    batch: Mapping[str, torch.Tensor],
    judge: PdmJudge,
    generator: torch.Generator,
) -> Row:
    """Return the PDM scores in one window: the best candidate's, and that of each way to choose.

    pdms_by_class: of the likeliest of those denoised; pdms_by_coarse, pdms_by_fine: by the scorers
    pdms_of_the_best: of all candidates, and pdms_of_the_best_plain of those without diversity noise
    spread_m, spread_plain_m: of the candidates' ends, with diversity noise and without
    """
    config, device = model.config, model.anchors.device
    scene = model.perception(**sensors_of(batch)).scene
    count = config.anchors * config.groups
    noise = torch.randn(1, count, POSES, 2, generator=generator).to(device)
    diversity = torch.randn(1, count, config.variants, 2, generator=generator).to(device)
    diversity[:, :, 0] = 0.0
    made = denoised(model, scene, noise)
    candidates = model.candidates(made.trajectories, diversity)
    coarse = model.coarse_scorer(candidates, scene)
    best = coarse.scores[0].argsort(descending=True)[: config.keep]
    layers = model.fine_scorer(candidates[:, best], coarse.features[:, best], scene)
    fine = model.deciding(layers, coarse.taken(best))
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
