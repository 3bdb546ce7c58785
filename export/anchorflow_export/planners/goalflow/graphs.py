"""GoalFlow, graph by graph: what torch.onnx traces for each role of the bundle."""

from __future__ import annotations

from torch import Tensor, nn

from anchorflow_models.goalflow import GoalFlow
from anchorflow_models.goalflow.goalflow import SURROUNDINGS

ENCODE_OUTPUTS = (
    "prior_mean",
    "prior_basis",
    "goals",
    "goal_scores",
    "features",
    "context",
    "course",
    *SURROUNDINGS,
)


class Encode(nn.Module):
    """The inputs of a request -> ENCODE_OUTPUTS, in their order."""

    def __init__(self, model: GoalFlow) -> None:
        super().__init__()
        self.model = model

    def forward(
        self, bev: Tensor, ego_status: Tensor, vehicle_size: Tensor, route: Tensor
    ) -> tuple[Tensor, ...]:
        context = self.model.encode(bev, ego_status, vehicle_size, route)
        return tuple(context[name] for name in ENCODE_OUTPUTS)


class Modulate(nn.Module):
    """times [K] and the context -> modulation [B,K,M]."""

    def __init__(self, model: GoalFlow) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Tensor:
        times, *context = inputs
        names = self.model.context_for_modulate
        return self.model.modulate(times, dict(zip(names, context, strict=True)))


class Field(nn.Module):
    """x_t and prior_mean [B,N,T,S], modulation [B,M] and the context -> dx_t [B,N,T,S]."""

    def __init__(self, model: GoalFlow) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Tensor:
        x_t, prior_mean, modulation, *context = inputs
        names = self.model.context_for_field
        return self.model.field(x_t, prior_mean, modulation, dict(zip(names, context, strict=True)))


class Score(nn.Module):
    """x_1 and prior_mean [B,N,T,S] and the context -> scores [B,N]."""

    def __init__(self, model: GoalFlow) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Tensor:
        x_1, prior_mean, *context = inputs
        names = self.model.context_for_score
        return self.model.score(x_1, prior_mean, dict(zip(names, context, strict=True)))
