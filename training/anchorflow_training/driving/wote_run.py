"""Train WoTE on driving logs with recorded or simulated sensors."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from anchorflow_models.sub_scores import pdm_score
from anchorflow_models.wote import WoTE, WoteConfig
from anchorflow_training.batches import Batch, reflection
from anchorflow_training.driving.anchors import anchor_scores, read_scores, read_token_scores
from anchorflow_training.driving.driving_run import SensorRun, SensorRunConfig
from anchorflow_training.driving.labels import CLASSES
from anchorflow_training.driving.log_cache import PLAN_SETTINGS, check_horizon
from anchorflow_training.driving.losses import distances
from anchorflow_training.driving.sensor_windows import sensors_of
from anchorflow_training.driving.wote_objective import WoteObjective, WoteObjectiveConfig
from anchorflow_training.record import Row
from anchorflow_training.settings import ConfigError, setting


@dataclass(frozen=True)
class WoteRunConfig(SensorRunConfig):
    """A run that learns WoTE from driving logs."""

    planner: ClassVar[str] = "wote"

    model: WoteConfig = field(default_factory=WoteConfig)
    objective: WoteObjectiveConfig = field(default_factory=WoteObjectiveConfig)
    rewards: str | None = setting(
        None,
        "Sub-scores of the anchors instead of the PDM scorer's: a folder of LOG.npy [w, K, 5], or "
        "an .npz of TOKEN [K, 5]; with batch.mirror also LOG.mirrored.npy or TOKEN.mirrored.",
    )


class WoteRun(SensorRun):
    """Learns to move anchors, and to foretell what each is worth."""

    config: WoteRunConfig

    def __init__(self, config: WoteRunConfig, logs: Sequence[Path], out: Path) -> None:
        if config.rewards and config.objective.moved:
            raise ConfigError(
                "rewards: expected none with objective.moved, whose anchors no table holds, "
                f"got {config.rewards}"
            )
        needs_all = config.rewards is None or config.evaluation.held_out > 0
        scored = "the PDM score without rewards, or of what is held out"
        check_horizon(config.model.num_steps, whole=scored if needs_all else None)
        super().__init__(config, logs, out)

    @staticmethod
    def model_settings(data: Sequence[Path]) -> Mapping[str, Any]:  # noqa: ARG004
        """The times of what was driven, and the classes of the semantic BEV that is drawn."""
        return {**PLAN_SETTINGS, "semantic_classes": len(CLASSES)}

    @cached_property
    def pdm(self) -> NDArray[np.float32]:
        """[W, K, 5] sub-scores of the model's anchors."""
        return self._scores(1.0, "")

    @cached_property
    def mirrored_pdm(self) -> NDArray[np.float32]:
        """[W, K, 5] of the anchors in reflected windows: of their reflections in these."""
        return self._scores(reflection(3), ".mirrored")

    def _scores(self, signs: float | NDArray[np.float32], suffix: str) -> NDArray[np.float32]:
        """Return the sub-scores of the anchors times signs: of the given tables, or worked out."""
        anchors = self.model.anchors.cpu().numpy()
        if self.config.rewards is None:
            return anchor_scores(self.logs, (anchors * signs).astype(np.float32))
        given = Path(self.config.rewards)
        if given.suffix == ".npz":
            return read_token_scores(given, self.logs, len(anchors), suffix=suffix)
        counts = np.bincount(self.windows.log, minlength=len(self.logs)).tolist()
        return read_scores(given, self.logs, counts, len(anchors), suffix=suffix)

    def begin(self, model: WoTE) -> None:
        """Anchors, and a backbone that has seen pictures where there is one."""
        shape = self.config.model
        model.set_anchors(self.first_anchors(count=shape.anchors, steps=shape.num_steps))
        self.load_sight(model)

    def new_objective(self, model: WoTE) -> WoteObjective:
        return WoteObjective(model, self.config.objective, self.judge)

    def stream(self, indices: Iterable[int]) -> Generator[Batch]:
        if not self.config.objective.moved:
            # Worked out here, and not by several loaders at once.
            _ = self.pdm, self.config.batch.mirror and self.mirrored_pdm
        return super().stream(indices)

    def window_batch(self, windows: NDArray[np.integer], *, mirrored: bool = False) -> Batch:
        batch, steps = super().window_batch(windows, mirrored=mirrored), self.config.model.num_steps
        batch |= {name: batch[name][:, :steps] for name in ("future", "occupancy")}
        if self.config.objective.moved:
            return batch
        pdm = self.mirrored_pdm if mirrored else self.pdm
        return {**batch, "pdm": pdm[windows]}

    def judged_batch(self, model: WoTE, batch: dict[str, torch.Tensor]) -> Row:
        """How well the anchors of a window are refined, and chosen.

        success: PDMS of the answer
        """
        seen = model.look(**sensors_of(batch))
        scored = model.score(seen.bev, seen.ego, seen.fine, seen.foretold, seen.motion)
        refined = distances(scored["trajectories"], batch["future"])
        counts = 1.0 if batch["is_example"][0] else math.nan
        worth = pdm_score(self.judge(batch["window"], scored["trajectories"]))[0]
        return {
            "success": float(worth[int(scored["scores"][0].argmax())]),
            "pdms_by_imitation": float(worth[int(scored["im_rewards"][0].argmax())]),
            "pdms_of_the_best": float(worth.max()),
            "best_ade_m": counts * float(distances(model.anchors[None], batch["future"]).min()),
            "best_refined_ade_m": counts * float(refined.min()),
        }
