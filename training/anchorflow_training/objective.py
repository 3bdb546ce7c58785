"""The flow-matching loss of a planner, as one module that a trainer can wrap and spread."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from anchorflow_models import L2SafetyCFM
from anchorflow_models.flow_matching import flow_matching_loss, interpolate
from anchorflow_training.config import FlowMatchingConfig
from anchorflow_training.coupling import couple
from anchorflow_training.flow_time import draw_flow_times


class FlowObjective(nn.Module):
    """Loss and its terms on a batch, in the model's normalised units."""

    def __init__(self, model: L2SafetyCFM, config: FlowMatchingConfig) -> None:
        super().__init__()
        self.model, self.config = model, config

    def draw(self, scenes: int, samples: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Noise [B, N, R] and flow times [B, N]; on the CPU, so alike on every device."""
        noise = torch.randn(scenes, samples, self.model.prior.rank, generator=generator)
        return noise, draw_flow_times(self.config, (scenes, samples), generator)

    def forward(
        self, batch: Mapping[str, Tensor], noise: Tensor, t: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: inputs of encode [B, ...]; states and prior_mean [B, N, T, S], route [B, N];
        starts [B, N, R] and sample_weights [B, N] if any."""
        model, inputs = self.model, dict(batch)
        data, mean, route = (inputs.pop(name) for name in ("states", "prior_mean", "route"))
        starts, sample_weights = (inputs.pop(name, None) for name in ("starts", "sample_weights"))
        context = model.encode(**inputs)
        with torch.no_grad():
            if starts is not None:
                x_0 = mean + model.prior.disturbed(starts)
            else:
                x_0 = model.draw(noise, mean, context)
                if self.config.optimal_transport:
                    x_0 = paired(x_0, data, route, model.config.dim)
            x_t, target = interpolate(x_0, data, t)
            state = model.prior.normalise(x_t - mean, context["units"])
            target = model.prior.normalise(target, context["units"])
        modulation = model.modulate(t, context)
        predicted = model.normalised_field(x_t, state, mean, modulation, context)
        return flow_matching_loss(
            predicted.float(), target, self.config.weights, sample_weights=sample_weights
        )


def paired(x_0: Tensor, data: Tensor, route: Tensor, dim: int) -> Tensor:
    """x_0 [B, N, T, S] reordered within each route [B, N] of a scene to lie near the data."""
    points = [x[:, :, ::4, :dim].flatten(2).cpu().numpy() for x in (data, x_0)]
    order = torch.from_numpy(couple(*points, groups=route.cpu().numpy())).to(x_0.device)
    return torch.take_along_dim(x_0, order[..., None, None], 1)
