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
from anchorflow_models.layers.in_float32 import in_float32
from anchorflow_trajectory.ode.method import Method
from anchorflow_trajectory.ode.schedule import Schedule, stage_times
from anchorflow_trajectory.ode.tableau import EULER, MIDPOINT

Context = dict[str, Tensor]


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

    limits: [B, 4]; where they have a horizon, no duration is drawn
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
