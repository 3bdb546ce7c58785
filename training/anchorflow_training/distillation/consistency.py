"""Consistency distillation (Song et al., 2023): every point of a teacher's path leads to one end.

    f(z_t, t) = z_t + (1 - t) v(z_t, t)        the end, as the student sees it from t
    f(z_t, t)  ->  f(z_s, s),  s > t           z_s by one step of the teacher's ODE from z_t

At s = 1 the end is z_s itself, and from there it spreads back to t = 0. No pairs are needed: z_t
lies between data and noise, as in the teacher's own training.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from anchorflow_models import L2SafetyCFM
from anchorflow_models.flow_matching import LossWeights, flow_matching_loss, interpolate
from anchorflow_training.distillation.normalised_flow import NormalisedFlow, started
from anchorflow_training.objective import paired


class ConsistencyObjective(nn.Module):
    """Distance between the ends that a student sees from neighbouring points of a teacher's path.

    The farther end is a target and passes no gradient; it is the student's own, not an average of
    it (Song & Dhariwal, 2024).

    intervals: [0, 1] is cut into so many; a midpoint step of the teacher crosses one
    optimal_transport: as the teacher was trained, so that z_t lies where its paths are
    """

    def __init__(
        self,
        model: L2SafetyCFM,
        teacher: L2SafetyCFM,
        *,
        intervals: int,
        optimal_transport: bool,
        weights: LossWeights,
    ) -> None:
        super().__init__()
        self.model, self.teacher, self.weights = model, teacher, weights
        self.intervals, self.optimal_transport = intervals, optimal_transport

    def draw(self, scenes: int, samples: int, generator: torch.Generator) -> tuple[Tensor, ...]:
        """Noise [B, N, R] and the intervals' first times [B, N]."""
        noise = torch.randn(scenes, samples, self.model.prior.rank, generator=generator)
        interval = torch.randint(self.intervals, (scenes, samples), generator=generator)
        return noise, interval / self.intervals

    def forward(
        self, batch: Mapping[str, Tensor], noise: Tensor, t: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: as of `FlowObjective`, states in SI; noise: [B, N, R]; t: [B, N]."""
        inputs = dict(batch)
        states, mean, route = (inputs.pop(name) for name in ("states", "prior_mean", "route"))
        starts, sample_weights = (inputs.pop(name, None) for name in ("starts", "sample_weights"))
        flow = NormalisedFlow.of(self.model, inputs, mean)
        with torch.no_grad():
            teacher = NormalisedFlow.of(self.teacher, inputs, mean)
            if starts is not None:
                x_0 = mean + self.model.prior.disturbed(starts)
            else:
                x_0 = self._noise(noise, states, route, inputs["limits"], teacher)
            z_t = teacher.normalised(interpolate(x_0, states, t)[0])
            h = 1.0 / self.intervals
            target = end_seen(flow, teacher.stepped(z_t, t, h), (t + h).clamp(max=1.0))
        seen = end_seen(flow, z_t, t)
        return flow_matching_loss(seen, target, self.weights, sample_weights=sample_weights)

    def _noise(
        self, noise: Tensor, data: Tensor, route: Tensor, limits: Tensor, flow: NormalisedFlow
    ) -> Tensor:
        """x_0 [B, N, T, S] in SI, paired with the data as the teacher's was."""
        x_0 = flow.in_si(started(self.model, noise, limits))
        return paired(x_0, data, route, self.model.config.dim) if self.optimal_transport else x_0


def end_seen(flow: NormalisedFlow, z: Tensor, t: Tensor) -> Tensor:
    """Where a straight way from z [B, N, T, S] at t [B, N] ends, at t = 1."""
    return z + (1.0 - t)[..., None, None] * flow.velocity(z, t)
