"""L2 safety-embedded conditional flow matching: cost map, state, goal and style in, anchors out.

Three parts, which export as three graphs, because they depend on less and less:

    encode     the scene                  once a scene
    modulate   the scene and flow time    once a scene for all times of a schedule
    field      the scene, time and x_t    at every evaluation
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from anchorflow_models.flowmp.condition_encoder import ConditionEncoder
from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.cost_map_encoder import CostMapEncoder
from anchorflow_models.flowmp.frame import Frame
from anchorflow_models.flowmp.prior import TrajectoryPrior
from anchorflow_models.flowmp.transformer import create_flowmp_transformer
from anchorflow_models.flowmp.window import MapWindow
from anchorflow_models.layers.lookup import lookup

Context = dict[str, Tensor]

CONDITION_WIDTH = 256
RAW_CHANNELS = 5  # of the window, looked up beside the learned features


class L2SafetyCFM(nn.Module):
    """The whole planner. Everything that goes in or out is metric and in the cost map's frame."""

    context_for_modulate: ClassVar = ("condition",)
    context_for_field: ClassVar = ("prior_mean", "frame", "features")

    def __init__(self, config: L2Config) -> None:
        super().__init__()
        self.config = config
        self.prior = TrajectoryPrior(config)
        self.window = MapWindow(config.map_channels, config.map_size)
        self.cost_map_encoder = CostMapEncoder(self.window.channels, config.feature_channels)
        self.condition_encoder = ConditionEncoder(config, CONDITION_WIDTH)
        self.map_summary = nn.Linear(self.cost_map_encoder.summary_size, CONDITION_WIDTH)
        self.transformer = create_flowmp_transformer(
            config.variant,
            state_dim=config.state_dim,
            num_steps=config.num_steps,
            feature_channels=config.feature_channels + RAW_CHANNELS,
            condition_width=CONDITION_WIDTH,
            steps_per_token=config.steps_per_token,
        )

    def encode(
        self,
        cost_map: Tensor,
        map_geometry: Tensor,
        clearance_field: Tensor,
        cost_to_go: Tensor,
        x_curr: Tensor,
        x_goal: Tensor,
        w_style: Tensor,
    ) -> Context:
        """The scene as context tensors.

        cost_map: [B, C, H, W] in [0, 1]; map_geometry: [B, 3] origin x, y in m, resolution in m/cell
        clearance_field: [B, H, W] m beyond the robot's radius
        cost_to_go: [B, 2, H, W] m, from the start and to the goal
        x_curr: [B, 3D]; x_goal: [B, 2D]; w_style: [B, 3], sums to 1
        """
        dim = self.config.dim
        frame = Frame.between(x_curr[:, :dim], x_goal[:, :dim])
        maps = self.window(cost_map, map_geometry, clearance_field, cost_to_go, frame)
        features, summary = self.cost_map_encoder(maps)
        raw = maps[:, :RAW_CHANNELS].permute(0, 2, 3, 1)
        condition = self.condition_encoder(frame, x_curr, x_goal, w_style)
        return {
            "prior_mean": self.prior.mean(x_curr, x_goal),
            "prior_basis": self.prior.basis(frame),
            "frame": frame.pack(),
            "features": torch.cat([features, raw], -1),
            "condition": condition + self.map_summary(summary),
        }

    def modulate(self, times: Tensor, context: Context) -> Tensor:
        """AdaLN parameters [B, K, M] at flow times [K] or [B, K]."""
        return self.transformer.modulate(context["condition"], times)

    def field(self, x_t: Tensor, modulation: Tensor, context: Context) -> Tensor:
        """dx/dt [B, N, T, S] in SI at x_t [B, N, T, S].

        modulation: [B, M] where all samples share the flow time, [B, N, M] where each has its own.
        """
        frame = Frame.unpack(context["frame"], self.config.dim)
        state = self.prior.normalise(x_t, context["prior_mean"], frame)
        field = self.normalised_field(x_t, state, modulation, context)
        return self.prior.to_si(field, frame)

    def normalised_field(
        self, x_t: Tensor, state: Tensor, modulation: Tensor, context: Context
    ) -> Tensor:
        """The field of the normalised state; x_t in SI says where on the map to look."""
        batch, count, steps, _ = x_t.shape
        frame = Frame.unpack(context["frame"], self.config.dim)
        points = frame.place(x_t[..., :2].reshape(batch, count * steps, 2))
        seen = lookup(context["features"], points).reshape(batch, count, steps, -1)
        per_sample = modulation if modulation.ndim == 3 else modulation[:, None]
        return self.transformer(state, seen, per_sample)

    def draw(self, noise: Tensor, context: Context) -> Tensor:
        """x_0 [B, N, T, S] from standard normal noise [B or 1, N, R]."""
        mean = context["prior_mean"]
        return mean[:, None] + (noise @ context["prior_basis"]).unflatten(-1, mean.shape[1:])


def create_l2_safety_cfm(config: L2Config | None = None) -> L2SafetyCFM:
    """An untrained planner of the given configuration, the small one by default."""
    return L2SafetyCFM(config or L2Config())
