"""The configuration of a distillation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from anchorflow_models.flow_matching import LossWeights
from anchorflow_training.config import CostMapRunConfig
from anchorflow_training.settings import setting
from anchorflow_trajectory.ode.schedule import check_schedule


@dataclass(frozen=True)
class TeacherConfig:
    """How the teacher is asked: its noise, and the solver that makes pairs."""

    noise_scale: float = setting(1.0, "Spread of the noise, as its bundle is exported.", above=0)
    method: Literal["euler", "midpoint", "heun", "rk4", "ab2"] = setting(
        "midpoint", "Solver that makes pairs."
    )
    steps: int = setting(8, "Equal steps of that solver.", least=1)
    pairs: int = setting(16, "Pairs a scene.", least=1)
    scenes: int = setting(0, "First scenes of the dataset to make pairs on; 0: all.", least=0)
    seed: int = setting(0, "Of the pairs' noise.", least=0)


@dataclass(frozen=True)
class DistillConfig(CostMapRunConfig):
    """A run that teaches a student of FlowMP what a teacher does in many evaluations.

    schedule: flow times from 0 to 1; the student takes an Euler step from each to the next

    Raises:
        ValueError: the schedule does not rise from 0 to 1.
    """

    method: Literal["reflow", "direct", "consistency"] = setting(
        "direct", "What the student learns; docs/distillation.md."
    )
    schedule: tuple[float, ...] = setting((0.0, 1.0), "Flow times of its Euler steps, from 0 to 1.")
    steps: int = 4000
    learning_rate: float = 5e-4
    warmup: int = 200
    at_schedule: float = setting(
        0.5, "reflow: share of samples at the schedule's own times.", least=0, most=1
    )
    cost_weight: float = setting(
        0.0, "direct: of log(1 + J), J the cost that the finish begins with.", least=0
    )
    cost_margin: float = setting(
        0.1, "direct: m of clearance that J asks for, as the finish does.", least=0
    )
    intervals: int = setting(8, "consistency: intervals that [0, 1] is cut into.", least=1)
    weights: LossWeights = field(default_factory=LossWeights)
    teacher: TeacherConfig = field(default_factory=TeacherConfig)

    def __post_init__(self) -> None:
        if check_schedule(self.schedule)[0] != 0.0:
            raise ValueError(f"schedule: expected its first time to be 0, got {self.schedule}")
