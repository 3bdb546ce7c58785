"""The configuration of a V2X-VLM run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from anchorflow_models.v2x_vlm import V2XConfig
from anchorflow_training.batches import BatchConfig
from anchorflow_training.config import JudgeConfig, RunConfig
from anchorflow_training.settings import setting


@dataclass(frozen=True)
class LossConfig:
    """Weights of what is added to the smooth L1 of the waypoints, and how it is measured."""

    alignment: float = setting(0.1, "Of InfoNCE between picture and prompt; 0: none.", least=0)
    kappa: float = setting(0.07, "Its temperature.", above=0)
    distillation: float = setting(0.5, "Of the teacher, where there is one.", least=0)
    distil: Literal["distribution", "regression"] = setting(
        "distribution", "A softmax over coordinates, as published, or smooth L1 of waypoints."
    )
    temperature: float = setting(2.0, "Of the softmax.", above=0)
    location: float = setting(
        0.0, "Of where the nearest other is, told by the tower alone; 0: none.", least=0
    )
    next_token: float = setting(0.0, "Of telling the prompt again, word by word.", least=0)


@dataclass(frozen=True)
class V2XRunConfig(RunConfig):
    """A run that learns waypoints from pairs."""

    planner: ClassVar[str] = "v2x_vlm"
    begins_with: ClassVar = ("pretrained",)

    steps: int = setting(6000, "Optimiser steps in all.", least=1)
    learning_rate: float = setting(5e-4, "Peak learning rate.", above=0)
    batch: BatchConfig = field(default_factory=lambda: BatchConfig(scenes=8))
    evaluation: JudgeConfig = field(default_factory=lambda: JudgeConfig(every=500, scenes=64))
    model: V2XConfig = field(default_factory=V2XConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    roadside_dropout: float = setting(
        0.25,
        "Share of pairs whose roadside picture is withheld; 1: none is ever seen.",
        least=0,
        most=1,
    )
    text: bool = setting(True, "Show the prompts; false: a word that says nothing.")
    freeze_vision: bool = setting(False, "Leave the vision tower as it is.")
    pretrained: str | None = setting(None, "Folder of published Florence-2 weights to begin with.")
    teacher: str | None = setting(None, "Checkpoint of this planner to learn from as well.")
