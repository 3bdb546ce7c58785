"""Reflow (Liu et al., 2023): straight paths between the noise and what the teacher makes of it."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from anchorflow_models import L2SafetyCFM
from anchorflow_models.flow_matching import LossWeights, flow_matching_loss, interpolate
from anchorflow_training.distillation.normalised_flow import NormalisedFlow
from anchorflow_training.distillation.pair_batches import PAIRED
from anchorflow_trajectory.ode.schedule import Schedule


class ReflowObjective(nn.Module):
    """Flow matching on pairs (z_0, z_1): the field at z_t = t z_1 + (1 - t) z_0 is z_1 - z_0.

    at_schedule: share of the samples at the times where the student will be asked; the others are
        spread over [0, 1], which keeps the field a flow that any solver may follow
    """

    def __init__(
        self, model: L2SafetyCFM, *, schedule: Schedule, at_schedule: float, weights: LossWeights
    ) -> None:
        super().__init__()
        self.model, self.weights, self.at_schedule = model, weights, at_schedule
        self.times = torch.tensor(schedule[:-1])

    def draw(self, scenes: int, samples: int, generator: torch.Generator) -> tuple[Tensor, ...]:
        """Flow times [B, N]."""
        shape = scenes, samples
        t = torch.rand(shape, generator=generator)
        asked = self.times[torch.randint(len(self.times), shape, generator=generator)]
        return (torch.where(torch.rand(shape, generator=generator) < self.at_schedule, asked, t),)

    def forward(self, batch: Mapping[str, Tensor], t: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: as of `PairBatches`; t: [B, N]."""
        inputs = dict(batch)
        z_0, z_1, mean, _ = (inputs.pop(name) for name in PAIRED)
        z_t, target = interpolate(z_0, z_1, t)
        predicted = NormalisedFlow.of(self.model, inputs, mean).velocity(z_t, t)
        return flow_matching_loss(predicted, target, self.weights)
