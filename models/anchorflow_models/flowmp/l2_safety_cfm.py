"""L2 safety-embedded conditional flow matching: cost map, state, goal, style and limits in.

Three parts, which export as three graphs, because they depend on less and less:

    encode     the scene                  once a scene
    modulate   the scene and flow time    once a scene for all times of a schedule
    field      the scene, time and x_t    at every evaluation

A state is p, p', p'' in the trajectory's own time, and its log duration (`prior` says it): its
velocity is p' over the duration. Every anchor begins on a route of the scene, its prior mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn

from anchorflow_models.flowmp.config import MAP_STRIDE, L2Config
from anchorflow_models.flowmp.cost_map_encoder import (
    CostMapEncoder,
    MapEncoding,
    MapTokens,
    MapWindow,
)
from anchorflow_models.flowmp.frame import ConditionEncoder, Frame, Limits
from anchorflow_models.flowmp.prior import TrajectoryPrior
from anchorflow_models.flowmp.transformer import FlowMPTransformer, create_flowmp_transformer
from anchorflow_models.flowmp.unet1d import FlowMPUNet1D, create_flowmp_unet1d
from anchorflow_models.layers.geometry import in_float32
from anchorflow_models.layers.places import PLACE_OCTAVES, fourier_places, lookup

Context = dict[str, Tensor]

OF_BOTH = (
    *("num_steps", "condition_width", "map_attention", "width"),
    *("fourier_features", "fourier_scale"),
)
OF_TRANSFORMER = ("steps_per_token", "layers", "heads", "activation")
"""Options of the configuration that the backbones take."""
ROUTE_CHANNELS = 7  # channels of a step that describe its route
PACE_CHANNELS = 4  # velocity and acceleration in shares of their limits
STEEPNESS = (1 / 3, 1 / 20)  # p' and p'' of a route times these are of order one
MOST_PACE = 4.0  # limits, beyond which a noisy state says no more
WINDOWS = {"features": 1.0, "wide_features": 2.0}  # context tensor: width of its window


class L2SafetyCFM(nn.Module):
    """The whole planner. All inputs and outputs are metric and in the cost map's frame.

    `anchorflow_models.generation` draws anchors from it: `TrajectoryGenerator`, or in one call
    `generate_trajectory_anchors`.
    """

    context_for_modulate: ClassVar = ("condition",)

    def __init__(self, config: L2Config) -> None:
        super().__init__()
        self.config = config
        self.windows = dict(list(WINDOWS.items())[: config.map_scales])
        # Without lookup, and for map attention, the field reads each step's place in the window.
        self.tells_places = config.map_attention or not config.map_lookup
        features = config.feature_channels if config.map_lookup else 0
        self.prior = TrajectoryPrior(config)
        self.window = MapWindow(config.map_channels, config.map_size)
        self.cost_map_encoder = CostMapEncoder(self.window.channels, features)
        self.wider_map_encoders = nn.ModuleList(
            CostMapEncoder(self.window.channels, features) for _ in range(config.map_scales - 1)
        )
        self.condition_encoder = ConditionEncoder(config, config.condition_width)
        self.map_summary = nn.Linear(
            config.map_scales * self.cost_map_encoder.summary_size, config.condition_width
        )
        shared = {"state_dim": config.state_dim, "feature_channels": self._seen_channels()}
        shared |= {name: getattr(config, name) for name in OF_BOTH}
        if config.backbone == "unet":
            self.unet = create_flowmp_unet1d(config.variant, **shared)
        else:
            shared |= {name: getattr(config, name) for name in OF_TRANSFORMER}
            self.transformer = create_flowmp_transformer(config.variant, **shared)
        if config.map_attention:
            self.map_tokens = MapTokens(
                self.cost_map_encoder.coarse_channels,
                cells=config.map_size // MAP_STRIDE,
                widths=tuple(self.windows.values()),
            )

    @property
    def vector_field(self) -> FlowMPTransformer | FlowMPUNet1D:
        """The backbone, whichever it is."""
        return self.unet if self.config.backbone == "unet" else self.transformer

    @property
    def context_for_field(self) -> tuple[str, ...]:
        """Names of the context tensors that `field` reads."""
        looked_up = tuple(self.windows) if self.config.map_lookup else ()
        asked = ("map_keys_values",) if self.config.map_attention else ()
        return ("frame", "motion_limits", "units", "si_units", *looked_up, *asked)

    def encode(
        self,
        cost_map: Tensor,
        map_geometry: Tensor,
        clearance_field: Tensor,
        x_curr: Tensor,
        x_goal: Tensor,
        w_style: Tensor,
        limits: Tensor,
    ) -> Context:
        """The scene as context tensors.

        cost_map: [B, C, H, W] in [0, 1]
        map_geometry: [B, 3] origin x, origin y in m, resolution in m/cell
        clearance_field: [B, H, W] m beyond the robot's radius
        x_curr: [B, 3D]; x_goal: [B, 2D]; w_style: [B, 3], sums to 1
        limits: [B, 4] v_max in m/s, a_max in m/s^2, robot_radius in m, horizon_s in s or 0 where
            every anchor has its own duration
        """
        dim = self.config.dim
        frame = Frame.between(x_curr[:, :dim], x_goal[:, :dim])
        maps = [
            self.window(cost_map, map_geometry, clearance_field, frame.widened(width))
            for width in self.windows.values()
        ]
        encoders = (self.cost_map_encoder, *self.wider_map_encoders)
        encodings = [encoder(one) for encoder, one in zip(encoders, maps, strict=True)]
        summary = torch.cat([encoding.summary for encoding in encodings], -1)
        condition = self.condition_encoder(frame, x_curr, x_goal, w_style, limits)
        return {
            "prior_basis": self.prior.basis(frame, Limits.of(limits).horizon_s),
            "frame": frame.pack(),
            "motion_limits": limits[:, :2],
            "units": self.prior.units(frame),
            "si_units": self.prior.si_units(frame),
            "condition": condition + self.map_summary(summary),
            **self._map_context(maps, encodings),
        }

    def _map_context(self, maps: Sequence[Tensor], encodings: Sequence[MapEncoding]) -> Context:
        """Return the field's map inputs: tables to look up, keys and values to attend to."""
        context = {}
        if self.config.map_lookup:
            for name, one, encoding in zip(self.windows, maps, encodings, strict=True):
                raw = one.permute(0, 2, 3, 1)
                learned = [encoding.features] if encoding.features is not None else []
                context[name] = torch.cat([*learned, raw], -1)
        if self.config.map_attention:
            tokens = self.map_tokens([encoding.coarse for encoding in encodings])
            context["map_keys_values"] = self.vector_field.keys_values(tokens)
        return context

    def modulate(self, times: Tensor, context: Context) -> Tensor:
        """The vector field's shifts and scales [B, K, M] at flow times [K] or [B, K]."""
        return self.vector_field.modulate(context["condition"], times)

    def field(
        self, x_t: Tensor, prior_mean: Tensor, modulation: Tensor, context: Context
    ) -> Tensor:
        """dx/dt [B, N, T, S] in SI at x_t [B, N, T, S].

        prior_mean: [B, N, T, S], the route that each sample began on
        modulation: [B, M] where all samples share the flow time, [B, N, M] where each has its own.
        """
        state = self.prior.normalise(x_t - prior_mean, context["units"])
        field = self.normalised_field(x_t, state, prior_mean, modulation, context)
        return self.prior.to_si(field, context["si_units"])

    def normalised_field(
        self,
        x_t: Tensor,
        state: Tensor,
        prior_mean: Tensor,
        modulation: Tensor,
        context: Context,
    ) -> Tensor:
        """The field of the normalised state; x_t in SI says where on the map to look."""
        batch, count, steps, _ = x_t.shape
        frame = Frame.unpack(context["frame"], self.config.dim)
        points = frame.place(x_t[..., :2].reshape(batch, count * steps, 2))
        seen = self._seen(points, context).reshape(batch, count, steps, -1)
        told = self._told(x_t, prior_mean, frame, context["motion_limits"])
        per_sample = modulation if modulation.ndim == 3 else modulation[:, None]
        return self.vector_field(
            state,
            torch.cat([told.reshape(batch, count, steps, -1), seen], -1),
            per_sample,
            context.get("map_keys_values"),
        )

    @in_float32
    def _told(self, x_t: Tensor, prior_mean: Tensor, frame: Frame, motion_limits: Tensor) -> Tensor:
        """Where each step's route leads, and how near its limits it is: [B, N * T, 7 + 4]."""
        dim = self.config.dim
        v_max, a_max = motion_limits.unbind(-1)
        turn = frame.rotation[:, :2, :2]
        route, state = prior_mean.flatten(1, 2), x_t.flatten(1, 2)
        place, *steeper = (route[..., k * dim : k * dim + 2] for k in range(3))
        parts = [frame.place(place)]
        by_size = turn / frame.half_size[:, None, None]
        parts += [part @ (k * by_size) for part, k in zip(steeper, STEEPNESS, strict=True)]
        parts.append(route[..., -1:] + torch.log(v_max / frame.half_size)[:, None, None])
        pace = torch.exp(-state[..., -1:])
        for order, per, most in ((1, pace, v_max), (2, pace * pace, a_max)):
            vector = state[..., order * dim : order * dim + 2] * per
            share = (vector @ turn) / most[:, None, None]
            parts.append(share.clamp(-MOST_PACE, MOST_PACE))
        return torch.cat(parts, -1)

    def _seen(self, points: Tensor, context: Context) -> Tensor:
        """Return the features at window coordinates [B, P, 2]: [B, P, F]."""
        parts = [fourier_places(points)] if self.tells_places else []
        if self.config.map_lookup:
            parts += [lookup(context[name], points / width) for name, width in self.windows.items()]
        return torch.cat(parts, -1)

    def _seen_channels(self) -> int:
        looked_up = len(self.windows) * (self.config.feature_channels + self.window.channels)
        places = 4 * PLACE_OCTAVES if self.tells_places else 0
        told = ROUTE_CHANNELS + PACE_CHANNELS + places
        return told + (looked_up if self.config.map_lookup else 0)

    @in_float32
    def draw(self, noise: Tensor, prior_mean: Tensor, context: Context) -> Tensor:
        """x_0 [B, N, T, S] from standard normal noise [B or 1, N, R] around [B, N, T, S]."""
        spread = noise @ context["prior_basis"]
        return prior_mean + spread.unflatten(-1, prior_mean.shape[2:])


def create_l2_safety_cfm(config: L2Config | None = None) -> L2SafetyCFM:
    """An untrained planner of the given configuration, the small one by default."""
    return L2SafetyCFM(config or L2Config())
