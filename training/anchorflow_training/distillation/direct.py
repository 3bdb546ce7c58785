"""Direct distillation: the student's own few steps end where the teacher's many do.

With one step it is the regression of Luhman & Luhman (2021); with more, the gradient runs through
all of them, so that a later evaluation learns to mend what an earlier one has really left.
"""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor, nn

from anchorflow_models import L2SafetyCFM
from anchorflow_models.flow_matching import LossWeights, flow_matching_loss
from anchorflow_training.distillation.normalised_flow import NormalisedFlow
from anchorflow_trajectory.ode.schedule import Schedule


class DirectObjective(nn.Module):
    """Distance of the Euler solution on `schedule` from z_1."""

    def __init__(self, model: L2SafetyCFM, *, schedule: Schedule, weights: LossWeights) -> None:
        super().__init__()
        self.model, self.schedule, self.weights = model, schedule, weights

    def draw(self, *_: object) -> tuple[Tensor, ...]:
        """Nothing: the pairs are all the chance there is."""
        return ()

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: the inputs of encode; z_0, z_1 and prior_mean [B, N, T, S]."""
        inputs = dict(batch)
        z_0, z_1, mean = (inputs.pop(name) for name in ("z_0", "z_1", "prior_mean"))
        end = NormalisedFlow.of(self.model, inputs, mean).carried(z_0, schedule=self.schedule)
        return flow_matching_loss(end, z_1, self.weights)
