"""Train FlowMP on a scene dataset, judged on cost maps that are held out."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from anchorflow_models import L2SafetyCFM
from anchorflow_training.batches import Batch, draw_batch, left_to_learn
from anchorflow_training.config import CostMapRunConfig, FlowMatchingConfig, TrainerConfig
from anchorflow_training.dataset import SceneDataset, open_dataset
from anchorflow_training.evaluation import (
    Evaluator,
    JudgedScene,
    flow_evaluator,
    sample_picture,
    scores,
)
from anchorflow_training.objective import FlowObjective, prior_covariance
from anchorflow_training.record import Picture, Row
from anchorflow_training.run import Report, TrainingRun
from anchorflow_training.settings import ConfigError, check_fixed

__all__ = ["CFMTrainer", "FlowMatchingConfig", "Report", "TrainerConfig"]


class CostMapRun(TrainingRun):
    """A run of FlowMP, or of its student.

    dataset: the scenes to train on; evaluator: the judge, if scenes are held out
    """

    run_config: CostMapRunConfig

    def __init__(self, config: CostMapRunConfig, dataset: SceneDataset, out: Path) -> None:
        self.dataset, held_out = split(dataset, config)
        self.evaluator = self.new_evaluator(held_out) if held_out else None
        super().__init__(config, out)

    @staticmethod
    def model_settings(data: SceneDataset) -> Mapping[str, Any]:
        """Return T, D and C of the dataset."""
        return {name: getattr(data, name) for name in ("num_steps", "dim", "map_channels")}

    @abstractmethod
    def new_evaluator(self, held_out: SceneDataset) -> Evaluator:
        """Return the validation judge."""

    def scores(self, scenes: Sequence[JudgedScene]) -> Row:
        """Return the scores of judged scenes, with a `success`."""
        return scores(scenes)

    def batch(self, index: int) -> Batch:
        return draw_batch(self.dataset, self.run_config.batch, index)

    @property
    def data(self) -> dict[str, Any]:
        return dict(self.dataset.meta)

    @property
    def evaluates(self) -> bool:
        return self.evaluator is not None

    def evaluate(self, model: L2SafetyCFM) -> tuple[Row, Picture | None]:
        assert self.evaluator is not None
        scenes = self.evaluator.judged(model)
        shown = scenes[: self.run_config.evaluation.pictures]
        return self.scores(scenes), sample_picture(shown) if shown else None


class CFMTrainer(CostMapRun):
    """Conditional flow matching on the expert's trajectories."""

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


def split(
    dataset: SceneDataset, config: CostMapRunConfig
) -> tuple[SceneDataset, SceneDataset | None]:
    """Return the scenes to train on and those held out, if any; raise `ConfigError`."""
    held_out, path = config.evaluation.held_out, config.evaluation.dataset
    if held_out and path:
        raise ConfigError("evaluation: expected held_out or dataset, got both")
    left_to_learn(
        len(dataset), of=f"the scenes of {dataset.path}", held_out=held_out, batch=config.batch
    )
    training, judged = dataset, open_dataset(Path(path)) if path else None
    if held_out:
        training = _part(dataset, slice(None, -held_out))
        judged = _part(dataset, slice(-held_out, None))
    for part in (training, judged):
        if part:
            required = CostMapRun.model_settings(part)
            check_fixed(config.model, required, by=f"the scenes of {part.path}")
    return training, judged


def _part(dataset: SceneDataset, scenes: slice) -> SceneDataset:
    arrays = {name: array[scenes] for name, array in dataset.arrays.items()}
    return replace(dataset, arrays=arrays)
