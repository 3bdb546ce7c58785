"""Train a flow on a scene dataset."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from pathlib import Path

from anchorflow_models import L2SafetyCFM
from anchorflow_training.batches import Batch, batches
from anchorflow_training.config import FlowMatchingConfig, TrainerConfig
from anchorflow_training.cost_map_run import CostMapRun
from anchorflow_training.curve import Row
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.evaluation import Evaluator, JudgedScene, flow_evaluator, scores
from anchorflow_training.objective import FlowObjective
from anchorflow_training.prior_covariance import prior_covariance
from anchorflow_training.run import Report

__all__ = ["CFMTrainer", "FlowMatchingConfig", "Report", "TrainerConfig"]


class CFMTrainer(CostMapRun):
    """Conditional flow matching on the expert's trajectories; `TrainingRun` says the rest."""

    def __init__(self, config: TrainerConfig, dataset: SceneDataset, out: Path) -> None:
        self.config = config
        super().__init__(config, dataset, out)

    def begin(self, model: L2SafetyCFM) -> None:
        config = self.config
        covariance = prior_covariance(self.dataset, config.model, mirrored=config.batch.mirror)
        model.prior.set_covariance(covariance)

    def new_objective(self, model: L2SafetyCFM) -> FlowObjective:
        return FlowObjective(model, self.config.flow)

    def new_evaluator(self, held_out: SceneDataset) -> Evaluator:
        return flow_evaluator(held_out, self.config.evaluation)

    def stream(self, indices: Iterable[int]) -> Generator[Batch]:
        return batches(self.dataset, self.config.batch, indices)

    def scores(self, scenes: Sequence[JudgedScene]) -> Row:
        return scores(scenes)
