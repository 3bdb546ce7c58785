"""Direct distillation: the student's own few steps end where the teacher's many do.

With one step it is the regression of Luhman & Luhman (2021); with more, the gradient runs through
all of them, so that a later evaluation learns to mend what an earlier one has really left.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from anchorflow_models import L2SafetyCFM
from anchorflow_models.flow_matching import LossWeights, flow_matching_loss
from anchorflow_training.distillation.anchor_cost import AnchorCost
from anchorflow_training.distillation.normalised_flow import NormalisedFlow
from anchorflow_training.distillation.pair_batches import PAIRED
from anchorflow_trajectory.ode.schedule import Schedule


class DirectObjective(nn.Module):
    """Distance of the Euler solution on `schedule` from z_1, and what it costs.

        loss = flow matching loss + cost_weight mean(log(1 + J))

    cost: J of the splines that the finish fits to the student's ends; None: it does not count
    """

    def __init__(
        self,
        model: L2SafetyCFM,
        *,
        schedule: Schedule,
        weights: LossWeights,
        cost: AnchorCost | None = None,
        cost_weight: float = 0.0,
    ) -> None:
        super().__init__()
        self.model, self.schedule, self.weights = model, schedule, weights
        self.cost, self.cost_weight = cost, cost_weight

    def draw(self, *_: object) -> tuple[Tensor, ...]:
        """Nothing: the pairs are all the chance there is."""
        return ()

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: as of `PairBatches`."""
        inputs = dict(batch)
        z_0, z_1, mean, reference_s = (inputs.pop(name) for name in PAIRED)
        flow = NormalisedFlow.of(self.model, inputs, mean)
        end = flow.carried(z_0, schedule=self.schedule)
        loss, terms = flow_matching_loss(end, z_1, self.weights)
        if self.cost is None:
            return loss, terms
        cost = torch.log1p(self.cost(flow.in_si(end), inputs, reference_s)).mean()
        return loss + self.cost_weight * cost, {**terms, "cost": cost}
