"""A model's field over the states that it works in: residuals of unit spread, in the scene's axes.

In them noise is the same for every scene, a reflection is a change of sign, and half precision is
enough to keep.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from anchorflow_models import L2SafetyCFM
from anchorflow_models.generation.integrate import Stage, integrate
from anchorflow_training.objective import METRIC
from anchorflow_trajectory.ode.method import Method
from anchorflow_trajectory.ode.schedule import Schedule, stage_times
from anchorflow_trajectory.ode.tableau import EULER, MIDPOINT

Context = dict[str, Tensor]


@dataclass(frozen=True, eq=False)
class NormalisedFlow:
    """A model in B scenes."""

    model: L2SafetyCFM
    context: Context

    @staticmethod
    def of(model: L2SafetyCFM, inputs: Mapping[str, Tensor]) -> NormalisedFlow:
        """inputs: of encode"""
        context = model.encode(**inputs)
        return NormalisedFlow(model, context | {name: context[name].float() for name in METRIC})

    def velocity(self, z: Tensor, t: Tensor) -> Tensor:
        """dz/dt [B, N, T, S] at z and flow times t, [B, N] or [1] for all."""
        modulation = self.model.modulate(t, self.context)
        field = self.model.normalised_field(self.in_si(z), z, modulation, self.context)
        return field.float()

    def carried(self, z_0: Tensor, *, schedule: Schedule, method: Method = EULER) -> Tensor:
        """z at the schedule's end from z_0 [B, N, T, S] at its beginning."""
        times = torch.tensor(stage_times(method, schedule).times).to(z_0)

        def field(z: Tensor, stage: Stage) -> Tensor:
            return self.velocity(z, times[stage.time_index, None])

        return integrate(field, z_0, schedule=schedule, method=method)

    def stepped(self, z: Tensor, t: Tensor, stride: float) -> Tensor:
        """z at t + stride from z [B, N, T, S] at t [B, N], by one midpoint step."""
        schedule = (0.0, 1.0)  # of the step, in shares of its stride
        shares = stage_times(MIDPOINT, schedule).times.tolist()

        def field(z: Tensor, stage: Stage) -> Tensor:
            return stride * self.velocity(z, t + stride * shares[stage.time_index])

        return integrate(field, z, schedule=schedule, method=MIDPOINT)

    def in_si(self, z: Tensor) -> Tensor:
        """States in SI and the map's frame."""
        with torch.autocast(z.device.type, enabled=False):
            residual = self.model.prior.to_si(z.float(), self.context["si_units"])
            return self.context["prior_mean"][:, None] + residual

    def normalised(self, x: Tensor) -> Tensor:
        """The inverse of `in_si`."""
        with torch.autocast(x.device.type, enabled=False):
            return self.model.prior.normalise(x, self.context["prior_mean"], self.context["units"])


def start_states(model: L2SafetyCFM) -> Tensor:
    """[R, T, S]: the normalised state at t = 0 of each unit of noise, alike in every scene."""
    prior = model.prior
    states = torch.einsum("rdf,ftk->rtkd", prior.factor, prior.free)
    return (states / prior.spread).flatten(2)


def started(model: L2SafetyCFM, noise: Tensor) -> Tensor:
    """z_0 [B, N, T, S] of noise [B, N, R]; in float32 under autocast too."""
    with torch.autocast(noise.device.type, enabled=False):
        return torch.tensordot(noise, start_states(model), 1)


def drawn(
    model: L2SafetyCFM,
    inputs: Mapping[str, Tensor],
    noise: Tensor,
    *,
    schedule: Schedule,
    method: Method = EULER,
) -> Tensor:
    """States [B, N, T, S] in SI at t = 1 from noise [1, N, R]."""
    with torch.no_grad():
        flow = NormalisedFlow.of(model, inputs)
        z_0 = started(model, noise).expand(len(inputs["x_curr"]), -1, -1, -1)
        return flow.in_si(flow.carried(z_0, schedule=schedule, method=method))
