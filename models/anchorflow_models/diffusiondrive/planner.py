"""DiffusionDriveV2: truncated diffusion from a few anchors, scored coarse to fine.

Its parts are those of Zou et al. (DiffusionDriveV2, 2025) over Liao et al. (DiffusionDrive, CVPR
2025); docs/decisions/0017-truncated-diffusion.md says where it departs from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.diffusiondrive.config import (
    FIRST_S,
    FORETOLD_TIMES,
    POSES,
    STEP_S,
    DiffusionDriveConfig,
)
from anchorflow_models.diffusiondrive.denoiser import Denoiser, SceneFeatures
from anchorflow_models.diffusiondrive.scorers import CoarseScorer, FineScorer, Scored, least_of
from anchorflow_models.diffusiondrive.trajectories import Variants
from anchorflow_models.layers.attention import Decoder
from anchorflow_models.layers.geometry import standing_still
from anchorflow_models.transfuser import (
    AGENT_QUERIES,
    GROUND_WIDTH,
    MOTION,
    STATUS,
    STATUS_UNITS,
    AgentHead,
    BevValues,
    FarSight,
    GroundSemanticHead,
    GroundSight,
    OccupancyHead,
    Perceived,
    SemanticHead,
    SweepMotion,
    TransfuserBackbone,
    foretold_traffic,
    moved_ahead,
)

Outputs: TypeAlias = dict[str, Tensor]

USUAL_SPEEDS = (0.0, 2.0, 5.0, 9.0, 14.0)  # m/s
USUAL_CURVATURE = 0.03  # 1/m, of the outermost of the arcs that anchors are before k-means


@dataclass(frozen=True, eq=False)
class PerceivedScene(Perceived):
    """Predictions beside the plan, and the scene that denoiser and scorers look at."""

    scene: SceneFeatures


class Perception(nn.Module):
    """Camera, LiDAR and status to what denoiser and scorers look at."""

    status_units: Tensor

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        width, backbone = config.width, config.backbone
        self.tells_motion = config.ego_motion
        self.cells, self.ground_rows = backbone.bev_size, backbone.ground_rows
        self.backbone = TransfuserBackbone(backbone)
        self.narrow = nn.Conv2d(backbone.bev_width, width, 1)
        self.status = nn.Linear(STATUS, width)
        units = torch.tensor(STATUS_UNITS) if config.ego_motion else torch.ones(STATUS)
        self.register_buffer("status_units", units, persistent=False)
        self.places = nn.Parameter(0.02 * torch.randn(1, self.cells**2 + 1, width))
        self.queries = nn.Parameter(0.02 * torch.randn(1, 1 + AGENT_QUERIES, width))
        self.decoder = Decoder(
            width, config.heads, hidden=config.hidden, layers=config.query_layers
        )
        self.agents = AgentHead(width, config.hidden, reach=backbone.lidar_range)
        self.ground: GroundSight | None = None
        self.semantics: SemanticHead | GroundSemanticHead
        if config.ground_sight:
            self.ground = GroundSight(backbone)
            self.semantics = GroundSemanticHead(backbone, width, config.classes)
        else:
            self.semantics = SemanticHead(backbone, config.classes)
        self.occupancy = OccupancyHead(backbone.bev_channels, POSES)
        ground = GROUND_WIDTH if config.ground_sight else 0
        self.joined = nn.Sequential(
            nn.Linear(width + backbone.bev_channels + ground, width), nn.ReLU(), nn.LayerNorm(width)
        )
        self.values = nn.ModuleList(
            BevValues(width, width, kernel=config.value_kernel)
            for _ in range(config.denoiser_layers)
        )
        self.sweeps = SweepMotion(backbone) if config.encounters else None
        self.far = FarSight(backbone) if config.encounters else None

    def forward(
        self,
        camera: Tensor,
        lidar: Tensor,
        ego_status: Tensor,
        lidar_before: Tensor | None = None,
    ) -> PerceivedScene:
        """camera: uint8 [B, 3, H, W]; lidar, lidar_before: [B, 1, H', H'], as the backbone;
        ego_status: [B, 8]"""
        seen = self.backbone(camera, lidar, lidar_before)
        cells = self.narrow(seen.features).flatten(2).transpose(1, 2)
        status = self.status(ego_status / self.status_units)[:, None]
        known = torch.cat([cells, status], 1) + self.places
        decoded = self.decoder(self.queries.expand(known.shape[0], -1, -1), known)
        bev = self._joined(known[:, :-1], seen.upscaled, camera, ego_status)
        values = torch.stack([value(bev) for value in self.values], 1)
        ego, motion = decoded[:, :1], None
        if self.tells_motion:
            ego, motion = ego + status, ego_status[:, MOTION]
        moving, far, foretold = foretold_traffic(
            self.sweeps, self.far, (camera, lidar, lidar_before), seen.upscaled, FORETOLD_TIMES
        )
        scene = SceneFeatures(bev, values, decoded[:, 1:], ego, motion, foretold)
        agents, logits = self.agents(scene.agents)
        return PerceivedScene(
            agents=agents,
            agent_logits=logits,
            semantics=self.semantics(seen.upscaled if self.ground is None else bev),
            occupancy=self.occupancy(seen.upscaled),
            upscaled=seen.upscaled,
            moving=moving,
            far=far,
            scene=scene,
        )

    def _joined(self, cells: Tensor, upscaled: Tensor, camera: Tensor, status: Tensor) -> Tensor:
        """The coarse cells [B, h h, W] over the fine ones [B, C, H, H] -> [B, W, H, H]"""
        coarse = cells.transpose(1, 2).unflatten(-1, (self.cells, self.cells))
        size = [int(side) for side in upscaled.shape[-2:]]
        spread = F.interpolate(coarse, size=size, mode="bilinear", align_corners=False)
        parts = [spread, upscaled]
        if self.ground is not None:
            parts = [moved_ahead(part, self.ground_rows) for part in parts]
            parts.append(self.ground(camera, parts[1], status / self.status_units))
        return self.joined(torch.cat(parts, 1).permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


class DiffusionDriveV2(nn.Module):
    """encode, then denoise a few times, then coarse over all candidates and fine over the best.

    anchors: [A, T, 2] m, which the diffusion begins near; vocabulary: [K, T, 3], candidates always
    """

    anchors: Tensor
    vocabulary: Tensor

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        self.config = config
        self.perception = Perception(config)
        self.denoiser = Denoiser(config)
        self.variants = Variants(config)
        self.coarse_scorer, self.fine_scorer = CoarseScorer(config), FineScorer(config)
        self.register_buffer("anchors", usual_anchors(config.anchors))
        self.register_buffer("vocabulary", torch.zeros(config.vocabulary, POSES, 3))

    def encode(
        self,
        camera: Tensor,
        lidar: Tensor,
        ego_status: Tensor,
        lidar_before: Tensor | None = None,
    ) -> Outputs:
        """Return the inputs of the other graphs by name, and predictions about the scene."""
        seen = self.perception(camera, lidar, ego_status, lidar_before)
        begin = self.denoiser.space.normalised(self.anchors)
        scene = {"ego_motion": seen.scene.motion, "foretold": seen.scene.foretold}
        told = {name: tensor for name, tensor in scene.items() if tensor is not None}
        return told | {
            "anchors": begin.expand(camera.shape[0], -1, -1, -1),
            "bev": seen.scene.bev,
            "values": seen.scene.values,
            "agent_queries": seen.scene.agents,
            "ego_query": seen.scene.ego,
            "agents": seen.agents,
            "agent_scores": seen.agent_logits.sigmoid(),
            "bev_semantics": seen.semantics.softmax(1),
        }

    def denoise(
        self, x_t: Tensor, t: Tensor, values: Tensor, agent_queries: Tensor, ego_query: Tensor
    ) -> Outputs:
        """x_t: [B, N, T, 2] in the diffusion's units; t: [B] -> x_0, trajectories, class_scores"""
        scene = SceneFeatures(values, values, agent_queries, ego_query)
        found = self.denoiser(x_t, t, scene)[-1]
        return {
            "x_0": self.denoiser.space.normalised(found.trajectories[..., :2]),
            "trajectories": found.trajectories,
            "class_scores": found.logits,
        }

    def coarse(
        self,
        trajectories: Tensor,
        diversity: Tensor,
        bev: Tensor,
        agent_queries: Tensor,
        ego_query: Tensor,
        ego_motion: Tensor | None = None,
        foretold: Tensor | None = None,
        *,
        class_scores: Tensor,
    ) -> Outputs:
        """trajectories: [B, N, T, 3]; diversity: [B, N, V, 2] standard normal, 0 for none;
        class_scores: [B, N] ->
        candidates [B, M, T, 3], M = N V and the vocabulary; features, coarse_scores [B, M];
        poses_cls [B, M], the class score of what each came from, of the vocabulary the least;
        coarse_logits [B, M, 5 or 6] and, with `imitation`, coarse_imitation [B, M]
        """
        candidates = self.candidates(trajectories, diversity)
        scene = SceneFeatures(bev, bev, agent_queries, ego_query, ego_motion, foretold)
        scored = self.coarse_scorer(candidates, scene)
        return {
            "candidates": candidates,
            "features": scored.features,
            "coarse_scores": scored.scores,
            "poses_cls": self.of_candidates(class_scores, variants=diversity.shape[2]),
            "coarse_logits": scored.logits,
            **({} if scored.imitation is None else {"coarse_imitation": scored.imitation}),
        }

    def of_candidates(self, class_scores: Tensor, *, variants: int) -> Tensor:
        """[B, M] of class scores [B, N]: each variant has its trajectory's."""
        own = class_scores[..., None].expand(-1, -1, variants).flatten(1)
        if not len(self.vocabulary):
            return own
        least = class_scores.amin(-1, keepdim=True)
        return torch.cat([own, least.expand(-1, len(self.vocabulary))], -1)

    def set_vocabulary(self, poses: Tensor) -> None:
        """Take fixed candidates [K, T, 3]. Raises ValueError if all of them are zero."""
        self.vocabulary.copy_(poses)
        self.check_vocabulary()

    def check_vocabulary(self) -> None:
        """Raise ValueError if the vocabulary was never filled."""
        count = len(self.vocabulary)
        if count and not self.vocabulary.any():
            raise ValueError(f"vocabulary: expected {count} trajectories, got zeros alone")

    def candidates(self, trajectories: Tensor, diversity: Tensor) -> Tensor:
        """[B, M, T, 3]: the variants of trajectories [B, N, T, 3], and the vocabulary; those that
        hardly move stand."""
        made = standing_still(self.variants(trajectories, diversity))
        if not len(self.vocabulary):
            return made
        return torch.cat([made, self.vocabulary.expand(made.shape[0], -1, -1, -1)], 1)

    def fine(
        self,
        candidates: Tensor,
        features: Tensor,
        bev: Tensor,
        agent_queries: Tensor,
        ego_query: Tensor,
        ego_motion: Tensor | None = None,
        foretold: Tensor | None = None,
        coarse_logits: Tensor | None = None,
        coarse_imitation: Tensor | None = None,
    ) -> Outputs:
        """candidates: [B, M, T, 3]; features: [B, M, F]; the last two as of `coarse`, for a
        pessimistic network -> scores [B, M], sub_scores [B, M, 5] and, with `direction`,
        direction_scores [B, M]
        """
        scene = SceneFeatures(bev, bev, agent_queries, ego_query, ego_motion, foretold)
        layers, coarse = self.fine_scorer(candidates, features, scene), None
        if coarse_logits is not None:
            coarse = Scored(features, coarse_logits, coarse_imitation, self.config.imitation)
        scored = self.deciding(layers, coarse)
        return {
            "scores": scored.scores,
            "sub_scores": scored.sub_scores,
            **({} if scored.direction is None else {"direction_scores": scored.direction}),
        }

    def deciding(self, fine: Sequence[Scored], coarse: Scored | None) -> Scored:
        """What decides of candidates: the last layer of the fine scorer, or the least of all.

        coarse: what the coarse scorer foretells of them, which a pessimistic network asks too
        """
        if not self.config.pessimistic:
            return fine[-1]
        assert coarse is not None  # an input of `fine` for a pessimistic network
        return least_of([coarse, *fine])


def usual_anchors(count: int) -> Tensor:
    """[A, T, 2]: arcs of some speeds and curvatures, until k-means of data takes their place."""
    rows = -(-count // len(USUAL_SPEEDS))
    # Not torch.linspace, which forgets the device that is chosen around it once transformers has
    # loaded a network in this process.
    share = 2 * torch.arange(rows) / (rows - 1) - 1 if rows > 1 else torch.zeros(1)
    curvature = share * USUAL_CURVATURE
    speed = torch.tensor(USUAL_SPEEDS).repeat(rows)[:count, None]
    bend = curvature.repeat_interleave(len(USUAL_SPEEDS))[:count, None]
    along = speed * (FIRST_S + STEP_S * torch.arange(POSES))
    return torch.stack([along, 0.5 * bend * along.square()], -1)


def create_diffusiondrive(config: DiffusionDriveConfig) -> DiffusionDriveV2:
    """A network of that configuration, its weights drawn at random."""
    return DiffusionDriveV2(config)
