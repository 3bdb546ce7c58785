"""A training run of V2X-VLM: its settings, its loss and its data."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from anchorflow_models.v2x_vlm import V2XVLM, V2XConfig
from anchorflow_models.v2x_vlm.config import END
from anchorflow_models.v2x_vlm.network import (
    Fused,
    alignment,
    distribution_distillation,
    location,
    next_token,
    regression,
    regression_distillation,
)
from anchorflow_training.batches import Batch, BatchConfig, batch_scenes
from anchorflow_training.checkpoint import (
    Checkpoint,
    CheckpointError,
    load_checkpoint,
    restore_model,
)
from anchorflow_training.config import JudgeConfig, RunConfig
from anchorflow_training.record import Row
from anchorflow_training.run import TrainingRun
from anchorflow_training.settings import ConfigError, check_fixed, other_default, setting
from anchorflow_training.v2x.dataset import PairDataset
from anchorflow_training.v2x.evaluation import judge
from anchorflow_training.v2x.florence import load_pretrained
from anchorflow_training.v2x.recording import FUTURE, STEP_S
from anchorflow_training.v2x.text import UNTOLD, opened, token_rows


@dataclass(frozen=True)
class LossConfig:
    """Weights and settings of the terms that are added to the smooth L1 of the waypoints."""

    alignment: float = setting(0.1, "Of InfoNCE between picture and prompt; 0: none.", ge=0)
    kappa: float = setting(0.07, "Its temperature.", gt=0)
    distillation: float = setting(0.5, "Of the teacher, where there is one.", ge=0)
    distil: Literal["distribution", "regression"] = setting(
        "distribution", "A softmax over coordinates, as published, or smooth L1 of waypoints."
    )
    temperature: float = setting(2.0, "Of the softmax.", gt=0)
    location: float = setting(
        0.0, "Of where the nearest other is, told by the tower alone; 0: none.", ge=0
    )
    next_token: float = setting(0.0, "Of telling the prompt again, word by word.", ge=0)


@dataclass(frozen=True)
class V2XRunConfig(RunConfig):
    """A run that learns waypoints from pairs."""

    planner: ClassVar[str] = "v2x_vlm"
    begins_with: ClassVar = ("pretrained",)

    steps: int = other_default(RunConfig, "steps", 6000)
    learning_rate: float = other_default(RunConfig, "learning_rate", 5e-4)
    batch: BatchConfig = field(default_factory=lambda: BatchConfig(scenes=8))
    evaluation: JudgeConfig = field(default_factory=lambda: JudgeConfig(every=500, scenes=64))
    model: V2XConfig = field(default_factory=V2XConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    epochs: int = setting(
        0, "Passes over the pairs, each judged at its end; 0: as steps and evaluation say.", ge=0
    )
    roadside_dropout: float = setting(
        0.25,
        "Share of pairs whose roadside picture is withheld; 1: none is ever seen.",
        ge=0,
        le=1,
    )
    text: bool = setting(True, "Show the prompts; false: a word that says nothing.")
    freeze_vision: bool = setting(False, "Leave the vision tower as it is.")
    pretrained: str | None = setting(None, "Folder of published Florence-2 weights to begin with.")
    teacher: str | None = setting(None, "Checkpoint of this planner to learn from as well.")


class V2XObjective(nn.Module):
    """teacher: a trained network, which learns nothing here; None: there is none"""

    def __init__(self, model: V2XVLM, config: V2XRunConfig, teacher: V2XVLM | None) -> None:
        super().__init__()
        self.model, self.config = model, config
        # A list, so that the teacher's weights are not registered as parameters.
        self._teacher = [] if teacher is None else [teacher.eval().requires_grad_(False)]
        if config.freeze_vision:
            model.florence.model.vision_tower.requires_grad_(False)

    def draw(self, scenes: int, _samples: int, generator: torch.Generator) -> tuple[Tensor, ...]:
        """[B], whose roadside picture is withheld."""
        return (torch.rand(scenes, generator=generator) < self.config.roadside_dropout,)

    def forward(self, batch: dict[str, Tensor], withheld: Tensor) -> tuple[Tensor, dict]:
        """The loss and its terms."""
        loss, terms, _ = self.judged(batch, withheld)
        return loss, terms

    def judged(
        self, batch: dict[str, Tensor], withheld: Tensor
    ) -> tuple[Tensor, dict[str, Tensor], Tensor]:
        """The loss, its terms, and the waypoints [B,45,2], m."""
        weights = self.config.loss
        seen = _seen(self.model, batch)
        fused = self.model.fuse(*seen, ~withheld, batch["tokens"], batch["mask"])
        waypoints = self.model.drive(fused)
        terms = {"regression": regression(waypoints, batch["waypoints"])}
        total = terms["regression"]
        if weights.alignment and self.config.text:  # pairs of pictures with one text are no pairs
            terms["alignment"] = alignment(*self.model.align(fused), kappa=weights.kappa)
            total = total + weights.alignment * terms["alignment"]
        if self._teacher and weights.distillation:
            terms["distillation"] = self._distillation(waypoints, batch)
            total = total + weights.distillation * terms["distillation"]
        if weights.location:
            near, place = self.model.locate(*seen, ~withheld)
            terms["location"] = location(near, place, batch["nearest"])
            total = total + weights.location * terms["location"]
        if weights.next_token:
            terms["next_token"] = self._next_token(fused, batch)
            total = total + weights.next_token * terms["next_token"]
        return total, terms, waypoints

    def _distillation(self, waypoints: Tensor, batch: dict[str, Tensor]) -> Tensor:
        """The teacher sees both pictures whatever the student sees."""
        (teacher,) = self._teacher
        with torch.no_grad():
            everything = torch.ones(len(waypoints), dtype=torch.bool, device=waypoints.device)
            wanted = teacher.drive(_fused(teacher.to(waypoints.device), batch, everything))
        if self.config.loss.distil == "regression":
            return regression_distillation(waypoints, wanted)
        return distribution_distillation(
            waypoints, wanted, temperature=self.config.loss.temperature
        )

    def _next_token(self, fused: Fused, batch: dict[str, Tensor]) -> Tensor:
        tokens, mask = batch["tokens"], batch["mask"]
        before = nn.functional.pad(tokens[:, :-1], (1, 0), value=END)
        return next_token(self.model.describe(fused, before), tokens, mask)


def _fused(model: V2XVLM, batch: dict[str, Tensor], there: Tensor) -> Fused:
    return model.fuse(*_seen(model, batch), there, batch["tokens"], batch["mask"])


def _seen(model: V2XVLM, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Both pictures' features, of one pass of the tower."""
    both = model.look(torch.cat([batch["vehicle_image"], batch["infrastructure_image"]]))
    vehicle, infrastructure = both.chunk(2)
    return vehicle, infrastructure


def by_epochs(config: V2XRunConfig, pairs: int) -> V2XRunConfig:
    """The configuration with the steps of its epochs over so many pairs, if it has any."""
    if not config.epochs:
        return config
    every = max(1, pairs // (config.batch.scenes * config.accumulate * config.devices))
    evaluation = replace(config.evaluation, every=every)
    return replace(config, steps=config.epochs * every, evaluation=evaluation)


SMALLEST_SPREAD = 0.1
"""m, below which the spread of a waypoint is no unit to learn in."""


class V2XRun(TrainingRun):
    """Learns waypoints from the pairs of the sequences that are not held out.

    Raises `ConfigError` if the model is not of the dataset's shape, a prompt is too long for it, or
    there are fewer pairs than a batch has; `CheckpointError` if a checkpoint it uses has another
    tokenizer than the dataset.
    """

    def __init__(self, config: V2XRunConfig, dataset: PairDataset, out: Path) -> None:
        self.config, self.dataset = config, dataset
        check_fixed(config.model, self.model_settings(dataset), by="the pairs")
        self.trained_on = dataset.indices(held_out=False)
        if len(self.trained_on) < config.batch.scenes:
            most = f"at most {len(self.trained_on)}, the pairs that there are"
            raise ConfigError(f"batch.scenes: expected {most}, got {config.batch.scenes}")
        self.config = config = by_epochs(config, len(self.trained_on))
        self._tokenizer = opened(dataset.tokenizer)
        longest = max(len(each.ids) for each in self._tokenizer.encode_batch([*dataset.prompts]))
        if config.text and longest > (most := config.model.max_tokens):
            expected = f"at least {longest}, as the longest prompt has"
            raise ConfigError(f"model.max_tokens: expected {expected}, got {most}")
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
        plans, loss = self.plans(model, indices, roadside=self.config.roadside_dropout < 1)
        return {**judge(self.dataset, indices, plans), "loss": loss}, None

    @torch.no_grad()
    def plans(
        self, model: V2XVLM, indices: NDArray[np.int64], *, roadside: bool = True
    ) -> tuple[NDArray[np.float64], float]:
        """[N,45,2] m, of pairs, and their mean loss; the roadside picture is seen if `roadside`."""
        objective, plans, total = V2XObjective(model, self.config, self._teacher), [], 0.0
        for part in np.array_split(indices, max(1, len(indices) // self.config.batch.scenes)):
            rows = {name: torch.from_numpy(each) for name, each in self._rows(part).items()}
            withheld = torch.full((len(part),), not roadside)
            loss, _, waypoints = objective.judged(*self.fabric.to_device((rows, withheld)))
            plans.append(waypoints.double().cpu().numpy())
            total += len(part) * float(loss)
        return np.concatenate(plans), total / len(indices)

    def _resume(self, saved: Checkpoint) -> None:
        self._check_tokenizer(self.model, source=str(self.checkpoint_path))
        super()._resume(saved)

    def batch(self, index: int) -> Batch:
        rows = batch_scenes(len(self.trained_on), self.config.batch, index)
        return self._rows(self.trained_on[rows])

    def _rows(self, indices: NDArray[np.int64]) -> Batch:
        texts = [self.dataset.prompts[index] if self.config.text else UNTOLD for index in indices]
        tokens, mask = token_rows(self._tokenizer, texts, most=self.config.model.max_tokens)
        names = ("vehicle_image", "infrastructure_image", "waypoints")
        arrays = {name: np.array(self.dataset.arrays[name][indices]) for name in names}
        nearest = self.dataset.nearest_others(indices)
        return {**arrays, "tokens": tokens, "mask": mask, "nearest": nearest}
