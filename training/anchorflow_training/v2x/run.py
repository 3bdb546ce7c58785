"""A training run of V2X-VLM; `TrainingRun` says the rest."""

from __future__ import annotations

import hashlib
from collections.abc import Generator, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from anchorflow_models.v2x_vlm import V2XVLM
from anchorflow_training.batches import Batch, batch_scenes, prefetched
from anchorflow_training.checkpoint import Checkpoint, CheckpointError, load_checkpoint
from anchorflow_training.curve import Row
from anchorflow_training.restore import restore_model
from anchorflow_training.run import TrainingRun
from anchorflow_training.settings import ConfigError, check_fixed
from anchorflow_training.v2x.config import V2XRunConfig
from anchorflow_training.v2x.dataset import PairDataset
from anchorflow_training.v2x.evaluation import judge
from anchorflow_training.v2x.objective import V2XObjective
from anchorflow_training.v2x.pretrained import load_pretrained
from anchorflow_training.v2x.prompts import UNTOLD
from anchorflow_training.v2x.recording import FUTURE, STEP_S
from anchorflow_training.v2x.tokenizer import opened, token_rows

SMALLEST_SPREAD = 0.1
"""m, below which the spread of a waypoint is no unit to learn in."""


class V2XRun(TrainingRun):
    """Learns waypoints from the pairs of the sequences that are not held out.

    Raises:
        ConfigError: the model is not of the dataset's shape, or there are fewer pairs than a batch
            has.
        CheckpointError: what it begins with, goes on with or learns from has another tokenizer
            than the dataset.
    """

    def __init__(self, config: V2XRunConfig, dataset: PairDataset, out: Path) -> None:
        self.config, self.dataset = config, dataset
        check_fixed(config.model, self.model_settings(dataset), by="the pairs")
        self.trained_on = dataset.indices(held_out=False)
        if len(self.trained_on) < config.batch.scenes:
            most = f"at most {len(self.trained_on)}, the pairs that there are"
            raise ConfigError(f"batch.scenes: expected {most}, got {config.batch.scenes}")
        self._tokenizer = opened(dataset.tokenizer)
        self._teacher, self._learnt_from = self._load_teacher()
        super().__init__(config, out)

    @staticmethod
    def model_settings(data: PairDataset) -> Mapping[str, Any]:
        """Size and times of the pairs, and their tokenizer's words."""
        return {
            "image_size": data.meta["image_size"],
            "vocabulary": data.vocabulary,
            "waypoints": FUTURE,
            "dt": STEP_S,
        }

    def _load_teacher(self) -> tuple[V2XVLM | None, dict[str, Any]]:
        """The teacher, if there is one, and what the checkpoint says of it."""
        if self.config.teacher is None:
            return None, {}
        path = Path(self.config.teacher)
        saved = load_checkpoint(path)
        if saved.planner != self.config.planner:
            raise CheckpointError(f"{path}: expected a v2x_vlm, got one of {saved.planner}")
        teacher = restore_model(saved)
        self._check_tokenizer(teacher, source=str(path))
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        return teacher, {"sha256": digest, "step": saved.step}

    def _check_tokenizer(self, model: V2XVLM, *, source: str) -> None:
        if model.tokenizer != self.dataset.tokenizer:
            raise CheckpointError(
                f"{source}: expected the tokenizer of the pairs in {self.dataset.path}, got another"
            )

    def called_parts(self, model: V2XVLM) -> Iterable[nn.Module]:
        florence = model.florence.model
        heads = [part for part in model.children() if part is not model.florence]
        language = [florence.language_model.encoder, florence.language_model.decoder]
        seeing = [florence.vision_tower, florence.multi_modal_projector]
        return [*seeing, *language, model.florence.lm_head, *heads]

    def begin(self, model: V2XVLM) -> None:
        model.tokenizer = self.dataset.tokenizer
        if self.config.pretrained:
            load_pretrained(model, Path(self.config.pretrained))
        waypoints = torch.from_numpy(np.array(self.dataset.arrays["waypoints"][self.trained_on]))
        model.mean.copy_(waypoints.mean(0))
        model.scale.copy_(waypoints.std(0).clamp_min(SMALLEST_SPREAD))

    def begin_after(self, model: V2XVLM, weights: Mapping[str, Tensor]) -> None:
        super().begin_after(model, weights)
        self._check_tokenizer(model, source=f"before: {self.config.before}")

    def new_objective(self, model: V2XVLM) -> nn.Module:
        return V2XObjective(model, self.config, self._teacher)

    def stream(self, indices: Iterable[int]) -> Generator[Batch]:
        return prefetched(self._batch, indices)

    @property
    def learnt_from(self) -> dict[str, Any]:
        return self._learnt_from

    @property
    def data(self) -> dict[str, Any]:
        meta = self.dataset.meta
        return {name: meta[name] for name in ("format", "image_size", "names", "held_out")}

    @property
    def evaluates(self) -> bool:
        return True

    def evaluate(self, model: V2XVLM) -> tuple[Row, None]:
        held = self.dataset.indices(held_out=True)
        count = min(self.config.evaluation.scenes, len(held))
        indices = held[np.linspace(0, len(held) - 1, count).astype(int)]
        see = self.config.roadside_dropout < 1
        return judge(self.dataset, indices, self.plans(model, indices, roadside=see)), None

    @torch.no_grad()
    def plans(
        self, model: V2XVLM, indices: NDArray[np.int64], *, roadside: bool = True
    ) -> NDArray[np.float64]:
        """[N,45,2] m, of pairs; without the roadside picture where `roadside` is false."""
        plans = []
        for part in np.array_split(indices, max(1, len(indices) // self.config.batch.scenes)):
            inputs = {name: torch.from_numpy(each) for name, each in self._rows(part).items()}
            inputs = self.fabric.to_device(inputs)
            there = torch.full((len(part),), roadside, device=self.fabric.device)
            vehicle = model.look(inputs["vehicle_image"])
            infrastructure = model.look(inputs["infrastructure_image"])
            fused = model.fuse(vehicle, infrastructure, there, inputs["tokens"], inputs["mask"])
            plans.append(model.drive(fused).double().cpu().numpy())
        return np.concatenate(plans)

    def _resume(self, saved: Checkpoint) -> None:
        self._check_tokenizer(self.model, source=str(self.checkpoint_path))
        super()._resume(saved)

    def _batch(self, index: int) -> Batch:
        rows = batch_scenes(len(self.trained_on), self.config.batch, index)
        return self._rows(self.trained_on[rows])

    def _rows(self, indices: NDArray[np.int64]) -> Batch:
        texts = [self.dataset.prompts[index] if self.config.text else UNTOLD for index in indices]
        tokens, mask = token_rows(self._tokenizer, texts, most=self.config.model.max_tokens)
        names = ("vehicle_image", "infrastructure_image", "waypoints")
        arrays = {name: np.array(self.dataset.arrays[name][indices]) for name in names}
        nearest = self.dataset.nearest_others(indices)
        return {**arrays, "tokens": tokens, "mask": mask, "nearest": nearest}
