"""The distillation loss: the student's few steps end where the teacher's many do.

With one step it is the regression of Luhman & Luhman (2021); with more, the gradient runs through
all of them, so that a later evaluation learns to correct what an earlier one really left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from anchorflow_models import L2SafetyCFM
from anchorflow_models.flow_matching import LossWeights, flow_matching_loss
from anchorflow_models.layers.geometry import in_float32
from anchorflow_training.distillation.anchor_cost import AnchorCost
from anchorflow_trajectory.ode.integrate import integrate_plainly
from anchorflow_trajectory.ode.methods import EULER, Method
from anchorflow_trajectory.ode.schedule import Schedule

Context = dict[str, Tensor]

PAIRED = ("z_0", "z_1", "prior_mean", "reference_s")
"""The arrays of a batch of pairs beside the inputs of encode."""


@dataclass(frozen=True, eq=False)
class NormalisedFlow:
    """A model in B scenes; prior_mean: [B, N, T, S], the route that each sample begins on."""

    model: L2SafetyCFM
    context: Context
    prior_mean: Tensor

    @staticmethod
    def of(model: L2SafetyCFM, inputs: Mapping[str, Tensor], prior_mean: Tensor) -> NormalisedFlow:
        """inputs: of encode"""
        return NormalisedFlow(model, model.encode(**inputs), prior_mean)

    def velocity(self, z: Tensor, t: Tensor) -> Tensor:
        """dz/dt [B, N, T, S] at z and flow times t, [B, N] or [1] for all."""
        modulation = self.model.modulate(t, self.context)
        x_t = self.in_si(z)
        field = self.model.normalised_field(x_t, z, self.prior_mean, modulation, self.context)
        return field.float()

    def carried(self, z_0: Tensor, *, schedule: Schedule, method: Method = EULER) -> Tensor:
        """z at the schedule's end from z_0 [B, N, T, S] at its beginning."""

        def field(z: Tensor, t: float) -> Tensor:
            return self.velocity(z, torch.tensor([t]).to(z))

        return integrate_plainly(field, z_0, schedule=schedule, method=method)

    def in_si(self, z: Tensor) -> Tensor:
        """States in SI and the map's frame."""
        return self.prior_mean + self.model.prior.to_si(z.float(), self.context["si_units"])


def start_states(model: L2SafetyCFM) -> Tensor:
    """[R, T, S]: the normalised state at t = 0 of each unit of noise, alike in every scene."""
    return model.prior.disturbed(model.prior.factor) / model.prior.spread


@in_float32
def started(model: L2SafetyCFM, noise: Tensor, limits: Tensor) -> Tensor:
    """z_0 [B, N, T, S] of noise [B or 1, N, R].

    limits: [B, 4]; with a horizon, no duration is drawn
    """
    drawn = torch.tensordot(noise, start_states(model), 1)
    scale = drawn.new_ones(len(limits), drawn.shape[-1])
    scale[:, -1] = (limits[:, 3] <= 0).to(drawn)
    return drawn * scale[:, None, None]


def drawn(
    model: L2SafetyCFM,
    inputs: Mapping[str, Tensor],
    noise: Tensor,
    prior_mean: Tensor,
    *,
    schedule: Schedule,
    method: Method = EULER,
) -> Tensor:
    """States [B, N, T, S] in SI at t = 1 from noise [1, N, R]."""
    with torch.no_grad():
        flow = NormalisedFlow.of(model, inputs, prior_mean)
        z_0 = started(model, noise, inputs["limits"])
        return flow.in_si(flow.carried(z_0, schedule=schedule, method=method))


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
