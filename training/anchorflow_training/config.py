"""The configuration of a training run: one nested value, which the checkpoint carries whole."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from anchorflow_models import L2Config
from anchorflow_models.flow_matching import LossWeights
from anchorflow_training.batches import BatchConfig, FlowBatchConfig
from anchorflow_training.settings import setting


@dataclass(frozen=True)
class FlowMatchingConfig:
    """The objective: weights of the fields, the pairing of noise and data, and flow times."""

    weights: LossWeights = field(default_factory=LossWeights)
    optimal_transport: bool = setting(True, "Pair noise with the nearest data of its scene.")
    flow_time: Literal["uniform", "logit_normal", "late"] = setting(
        "uniform", "How flow times are drawn."
    )
    logit_mean: float = setting(0.0, "Of logit_normal; above 0 is later than half.")
    logit_std: float = setting(1.0, "Of logit_normal.", gt=0)
    late_power: float = setting(2.0, "Of late: density proportional to t^(power - 1).", gt=0)
    loss: str | None = setting(
        None, "Loss of your own as package.module:function, called like `flow_matching_loss`."
    )


@dataclass(frozen=True)
class JudgeConfig:
    """The validation judge: how often, on how much, and when it ends the training."""

    every: int = setting(1000, "Steps from one evaluation to the next.", ge=1)
    scenes: int = setting(64, "Scenes an evaluation.", ge=1)
    patience: int = setting(
        0, "Stop after so many evaluations without a better success; 0: never.", ge=0
    )


@dataclass(frozen=True)
class HeldOutConfig(JudgeConfig):
    """A judge of what the run keeps from training."""

    held_out: int = setting(
        0, "Last scenes of the dataset, kept from training; of driving logs whole ones.", ge=0
    )


@dataclass(frozen=True)
class AnchorJudgeConfig(HeldOutConfig):
    """A judge of anchors on cost maps."""

    dataset: str | None = setting(None, "Dataset folder to evaluate on, instead of held_out.")
    samples: int = setting(16, "Anchors a scene.", ge=1)
    pictures: int = setting(4, "Scenes on the sample picture; 0: no picture.", ge=0)


@dataclass(frozen=True)
class EvaluationConfig(AnchorJudgeConfig):
    """The judge of a flow, and the sampler that draws its anchors."""

    steps: int = setting(2, "Midpoint steps of the sampler.", ge=1)


@dataclass(frozen=True)
class RunConfig:
    """How long, how fast and on what; the rate climbs over `warmup`, then follows `rate_schedule`.

    planner: its name in the registry of planners, which a subclass says
    begins_with: settings of what a run begins with, which no run `before` leaves a use for
    model: the planner's own configuration, of the class that the registry names
    """

    planner: ClassVar[str]
    begins_with: ClassVar[tuple[str, ...]] = ()

    steps: int = setting(12_000, "Optimiser steps in all.", ge=1)
    learning_rate: float = setting(1e-3, "Peak learning rate.", gt=0)
    warmup: int = setting(500, "Steps over which the rate climbs.", ge=0)
    rate_schedule: Literal["cosine", "constant"] = setting(
        "cosine", "Of the rate after warm-up: falling, or constant."
    )
    weight_decay: float = setting(0.01, "Of AdamW.", ge=0)
    gradient_clip: float = setting(1.0, "Largest norm of the gradient.", gt=0)
    accumulate: int = setting(1, "Batches an optimiser step.", ge=1)
    ema_decay: float = setting(0.999, "Of the averaged weights.", ge=0, lt=1)
    precision: Literal["auto", "float32", "bfloat16", "float16"] = setting(
        "auto", "Of matrix products; auto: mixed on a GPU, float32 on a CPU."
    )
    compile: bool = setting(False, "Compile the networks with torch.compile.")
    accelerator: Literal["auto", "cpu", "cuda"] = setting("auto", "Where to train.")
    devices: int = setting(1, "GPUs, or processes on a CPU; each draws its own batches.", ge=1)
    threads: int = setting(0, "CPU threads a process; 0: as torch chooses.", ge=0)
    loaders: int = setting(1, "Threads that prepare batches ahead.", ge=1)
    before: str | None = setting(
        None, "Checkpoint of an earlier run of the same network, to begin with its weights."
    )
    checkpoint_every: int = setting(500, "Steps from one checkpoint to the next.", ge=1)
    report_every: int = setting(50, "Steps a line of the curve.", ge=1)
    tensorboard: bool = setting(True, "Write scalars and pictures for TensorBoard.")
    batch: BatchConfig = field(default_factory=BatchConfig)
    evaluation: JudgeConfig = field(default_factory=JudgeConfig)
    model: Any = None


@dataclass(frozen=True)
class CostMapRunConfig(RunConfig):
    """A run of FlowMP, which learns on cost maps."""

    planner: ClassVar[str] = "flowmp"

    batch: FlowBatchConfig = field(default_factory=FlowBatchConfig)
    evaluation: AnchorJudgeConfig = field(default_factory=AnchorJudgeConfig)
    model: L2Config = field(default_factory=L2Config)


@dataclass(frozen=True)
class TrainerConfig(CostMapRunConfig):
    """A run that learns FlowMP's flow from data."""

    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    flow: FlowMatchingConfig = field(default_factory=FlowMatchingConfig)
