"""The flow of some scenes: a planner's field, with what steers it, from noise to states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.generation.barrier import Barrier
from anchorflow_models.generation.config import ADAPTIVE, GeneratorConfig
from anchorflow_models.generation.guidance import Guidance
from anchorflow_models.generation.integrate import Stage, integrate, integrate_adaptive
from anchorflow_trajectory.ode.methods import method_named
from anchorflow_trajectory.ode.schedule import Schedule, stage_times

Context = dict[str, Tensor]


class FlowPlanner(Protocol):
    """What a generator asks of a model; `L2SafetyCFM` is one and says what the tensors are."""

    @property
    def config(self) -> L2Config: ...

    def encode(
        self,
        cost_map: Tensor,
        map_geometry: Tensor,
        clearance_field: Tensor,
        x_curr: Tensor,
        x_goal: Tensor,
        w_style: Tensor,
        limits: Tensor,
    ) -> Context: ...

    def modulate(self, times: Tensor, context: Context) -> Tensor: ...

    def field(
        self, x_t: Tensor, prior_mean: Tensor, modulation: Tensor, context: Context
    ) -> Tensor: ...

    def draw(self, noise: Tensor, prior_mean: Tensor, context: Context) -> Tensor: ...


@dataclass(frozen=True, eq=False)
class SceneFlow:
    """dx/dt in B scenes: the model's field, then guidance, then the barrier, which so has the
    last word.

    prior_mean: [B, N, T, S], the route that each anchor begins on
    """

    model: FlowPlanner
    context: Context
    prior_mean: Tensor
    guidance: Guidance | None = None
    barrier: Barrier | None = None

    def solve(self, x: Tensor, config: GeneratorConfig, schedule: Schedule) -> Tensor:
        """The states at t = 1 from x [B, N, T, S] at the schedule's first time."""
        if config.method == ADAPTIVE:
            return self._solve_adaptive(x, config, schedule[0])
        method = method_named(config.method)
        times = stage_times(method, schedule).times
        modulation = self.model.modulate(torch.tensor(times).to(x), self.context)

        def field(x_t: Tensor, stage: Stage) -> Tensor:
            k = stage.time_index
            return self.velocity(x_t, float(times[k]), modulation[:, k], stride=stage.stride)

        return integrate(field, x, schedule=schedule, method=method)

    def velocity(
        self, x_t: Tensor, t: float, modulation: Tensor, *, stride: float | None
    ) -> Tensor:
        """dx/dt [B, N, T, S] at x_t and t; modulation: [B, M] of t; stride: None if adaptive."""
        field = self.model.field(x_t, self.prior_mean, modulation, self.context)
        basis = self.context["prior_basis"]
        if self.guidance is not None:
            field = self.guidance.guided(field, x_t, t, basis)
        if self.barrier is not None:
            field = self.barrier.kept(field, x_t, t, basis, stride=stride)
        return field

    def _solve_adaptive(self, x: Tensor, config: GeneratorConfig, start: float) -> Tensor:
        def field(t: Tensor, x_t: Tensor) -> Tensor:
            modulation = self.model.modulate(t[None], self.context)[:, 0]
            return self.velocity(x_t, float(t), modulation, stride=None)

        return integrate_adaptive(field, x, start=start, rtol=config.rtol, atol=config.atol)
