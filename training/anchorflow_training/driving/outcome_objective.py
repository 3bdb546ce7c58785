"""What GoalFlow's scorer learns: what becomes of trajectories."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_driving.pdm import SUB_SCORES
from anchorflow_models.goalflow import GoalFlow
from anchorflow_models.goalflow.outcome_scorer import LEARNT


class OutcomeObjective(nn.Module):
    """Loss and its terms on windows with `Proposals`: binary cross entropies of sub-scores.

    forgotten: share of what the scorer is told that each step leaves out
    """

    def __init__(self, model: GoalFlow, *, forgotten: float) -> None:
        super().__init__()
        self.model, self.forgotten = model, forgotten
        self.order = [SUB_SCORES.index(name) for name in LEARNT]

    def draw(self, scenes: int, samples: int, generator: torch.Generator) -> tuple[Tensor, ...]:  # noqa: ARG002
        """Nothing: what is forgotten hangs on the step's seed."""
        return ()

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        model, poses = self.model, batch["trajectories"]
        assert model.outcomes is not None
        with torch.no_grad():
            context = model.look(batch["bev"], batch["status"], batch["size"])
            told = model.told(model.judged(poses, context), context)
        kept = torch.rand(told.shape[-1], device=told.device) >= self.forgotten
        logits = model.outcomes(told * kept / (1 - self.forgotten), context["context"])
        losses = F.binary_cross_entropy_with_logits(
            logits, batch["scores"][..., self.order], reduction="none"
        ).mean((0, 1))
        return losses.sum(), dict(zip(LEARNT, losses, strict=True))
