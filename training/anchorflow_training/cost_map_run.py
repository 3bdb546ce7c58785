"""A training run on a scene dataset, judged on cost maps that it keeps from training."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from anchorflow_models import L2SafetyCFM
from anchorflow_training.config import CostMapRunConfig
from anchorflow_training.curve import Row
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.evaluation import Evaluator, JudgedScene
from anchorflow_training.held_out import shapes, split
from anchorflow_training.pictures import sample_picture
from anchorflow_training.run import Picture, TrainingRun


class CostMapRun(TrainingRun):
    """FlowMP's part of a run; `TrainingRun` says the rest.

    dataset: the scenes to train on; evaluator: the judge, where scenes are held out
    """

    run_config: CostMapRunConfig

    def __init__(self, config: CostMapRunConfig, dataset: SceneDataset, out: Path) -> None:
        self.dataset, held_out = split(dataset, config)
        self.evaluator = self.new_evaluator(held_out) if held_out else None
        super().__init__(config, out)

    @staticmethod
    def model_settings(data: SceneDataset) -> Mapping[str, Any]:
        return shapes(data)

    @abstractmethod
    def new_evaluator(self, held_out: SceneDataset) -> Evaluator:
        """The validation judge."""

    @abstractmethod
    def scores(self, scenes: Sequence[JudgedScene]) -> Row:
        """What judged scenes are worth; it has a `success`."""

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
