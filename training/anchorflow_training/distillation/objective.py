"""The losses of the three distillation methods: direct, reflow and consistency.

All work on normalised states: residuals of unit spread, in the scene's frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from anchorflow_models import L2SafetyCFM
from anchorflow_models.flow_matching import LossWeights, flow_matching_loss, interpolate
from anchorflow_models.layers.geometry import in_float32
from anchorflow_training.distillation.anchor_cost import AnchorCost
from anchorflow_training.objective import paired
from anchorflow_trajectory.ode.integrate import integrate_plainly
from anchorflow_trajectory.ode.methods import EULER, MIDPOINT, Method
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

    def stepped(self, z: Tensor, t: Tensor, stride: float) -> Tensor:
        """z at t + stride from z [B, N, T, S] at t [B, N], by one midpoint step."""

        def field(z: Tensor, share: float) -> Tensor:
            return stride * self.velocity(z, t + stride * share)

        return integrate_plainly(field, z, schedule=(0.0, 1.0), method=MIDPOINT)

    def end_from(self, z: Tensor, t: Tensor) -> Tensor:
        """The end at t = 1 of a straight path from z [B, N, T, S] at t [B, N]."""
        return z + (1.0 - t)[..., None, None] * self.velocity(z, t)

    def in_si(self, z: Tensor) -> Tensor:
        """States in SI and the map's frame."""
        return self.prior_mean + self.model.prior.to_si(z.float(), self.context["si_units"])

    def normalised(self, x: Tensor) -> Tensor:
        """The inverse of `in_si`."""
        return self.model.prior.normalise(x - self.prior_mean, self.context["units"])


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

    With one step it is the regression of Luhman & Luhman (2021); with more, the gradient runs
    through all, so that a later evaluation learns to correct what an earlier one really left.

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


class ReflowObjective(nn.Module):
    """Flow matching on pairs (Liu et al., 2023): the field at t z_1 + (1 - t) z_0 is z_1 - z_0.

    at_schedule: share of the samples at the schedule's times; the others are spread over [0, 1],
        which keeps the field a flow for any solver
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
        scheduled = self.times[torch.randint(len(self.times), shape, generator=generator)]
        chosen = torch.rand(shape, generator=generator) < self.at_schedule
        return (torch.where(chosen, scheduled, t),)

    def forward(self, batch: Mapping[str, Tensor], t: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: as of `PairBatches`; t: [B, N]."""
        inputs = dict(batch)
        z_0, z_1, mean, _ = (inputs.pop(name) for name in PAIRED)
        z_t, target = interpolate(z_0, z_1, t)
        predicted = NormalisedFlow.of(self.model, inputs, mean).velocity(z_t, t)
        return flow_matching_loss(predicted, target, self.weights)


class ConsistencyObjective(nn.Module):
    """Every point of a teacher's path leads to one end (Song et al., 2023).

        f(z_t, t) = z_t + (1 - t) v(z_t, t)   ->   f(z_s, s),  z_s a step of the teacher from z_t

    z_t lies between data and noise, as in the teacher's training, so no pairs are needed. The
    target passes no gradient; it is the student's own, not an average (Song & Dhariwal, 2024).

    intervals: equal parts of [0, 1]; a midpoint step of the teacher crosses one
    optimal_transport: whether noise and data are coupled, as in the teacher's training
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
        inputs, model = dict(batch), self.model
        states, mean, route = (inputs.pop(name) for name in ("states", "prior_mean", "route"))
        starts, sample_weights = (inputs.pop(name, None) for name in ("starts", "sample_weights"))
        flow = NormalisedFlow.of(model, inputs, mean)
        with torch.no_grad():
            teacher = NormalisedFlow.of(self.teacher, inputs, mean)
            if starts is not None:
                x_0 = mean + model.prior.disturbed(starts)
            else:
                x_0 = teacher.in_si(started(model, noise, inputs["limits"]))
                if self.optimal_transport:
                    x_0 = paired(x_0, states, route, model.config.dim)
            z_t = teacher.normalised(interpolate(x_0, states, t)[0])
            h = 1.0 / self.intervals
            target = flow.end_from(teacher.stepped(z_t, t, h), (t + h).clamp(max=1.0))
        seen = flow.end_from(z_t, t)
        return flow_matching_loss(seen, target, self.weights, sample_weights=sample_weights)
