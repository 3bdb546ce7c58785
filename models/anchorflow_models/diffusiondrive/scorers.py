"""Stages 2 and 3: how well each of many candidates would drive, coarsely and then finely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from anchorflow_models.diffusiondrive.config import POSES, STEP_S, DiffusionDriveConfig
from anchorflow_models.diffusiondrive.denoiser import BevAttention, SceneFeatures
from anchorflow_models.diffusiondrive.trajectories import (
    HEADING_FEATURES,
    MOTION_FEATURES,
    POINT_FEATURES,
    embedded_poses,
    motion_features,
)
from anchorflow_models.layers.attention import Attention, FeedForward
from anchorflow_models.layers.blocks import scalar_head
from anchorflow_models.lqr_rollout import halved
from anchorflow_models.sub_scores import SUB_SCORES, pdm_score
from anchorflow_models.transfuser import BevValues, Encounters, Footprint, driven_by_car

DIRECTION = "DDC"
"""Driving direction compliance, after SUB_SCORES if it is predicted."""


@dataclass(frozen=True, eq=False)
class Scored:
    """The predictions of a layer for M candidates.

    features: [B, M, F]; logits: [B, M, 5] in the order of SUB_SCORES, [B, M, 6] with DDC
    imitation: [B, M] logits over the candidates, of which a person would drive, if a head predicts
        them; weight: theirs in the scores
    """

    features: Tensor
    logits: Tensor
    imitation: Tensor | None
    weight: float

    def taken(self, chosen: Tensor) -> Scored:
        """Return the scores of the candidates at these places [K]."""
        imitation = None if self.imitation is None else self.imitation[:, chosen]
        return replace(
            self,
            features=self.features[:, chosen],
            logits=self.logits[:, chosen],
            imitation=imitation,
        )

    @property
    def sub_scores(self) -> Tensor:
        """[B, M, 5] in [0, 1]"""
        return self.logits[..., : len(SUB_SCORES)].sigmoid()

    @property
    def direction(self) -> Tensor | None:
        """[B, M] DDC in [0, 1], if a head predicts it."""
        told = self.logits.shape[-1] > len(SUB_SCORES)
        return self.logits[..., len(SUB_SCORES)].sigmoid() if told else None

    @property
    def scores(self) -> Tensor:
        """[B, M] in [0, 1]: the PDM score, with DDC where a head foretells it, times the likelihood
        beside that of the likeliest."""
        score = pdm_score(self.logits.sigmoid())
        if self.imitation is None:
            return score
        beside = self.imitation - self.imitation.amax(-1, keepdim=True)
        return score * (self.weight * beside).exp()


def least_of(judged: Sequence[Scored]) -> Scored:
    """The least that several scorers foretell of each sub-score, and their mean imitation.

    The best of hundreds is often the one that a scorer is wrong about; it is seldom the same one
    for all of them (as in clipped double Q-learning, Fujimoto et al., 2018).
    """
    last = judged[-1]
    told = [scored.imitation for scored in judged if scored.imitation is not None]
    return replace(
        last,
        logits=torch.stack([scored.logits for scored in judged]).amin(0),
        imitation=torch.stack(told).mean(0) if told else None,
    )


class ScorerLayer(nn.Module):
    """Candidates attend to the BEV along their points, to the agents, each other and the ego."""

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        width, heads = config.scorer_width, config.scorer_heads
        self.values = BevValues(config.width, width, kernel=config.value_kernel)
        self.look = BevAttention(
            width,
            points=POSES,
            heads=config.look_heads,
            reach=config.backbone.lidar_range,
            ahead=config.bev_ahead,
        )
        self.widen = nn.Linear(config.width, width)
        self.agents, self.ego = Attention(width, heads), Attention(width, heads)
        self.others = Attention(width, heads)
        self.feed_forward = FeedForward(width, config.scorer_hidden)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(5))
        foretold = (*SUB_SCORES, DIRECTION) if config.direction else SUB_SCORES
        self.heads = nn.ModuleList(scalar_head(width) for _ in foretold)
        self.weight = config.imitation
        self.imitation = scalar_head(width) if config.imitation else None

    def forward(self, x: Tensor, points: Tensor, scene: SceneFeatures) -> Scored:
        """x: [B, M, F]; points: [B, M, T, 2] m"""
        look, agents, others, ego, feed = self.norms
        x = look(x + self.look(x, points, self.values(scene.bev)))
        x = agents(x + self.agents(x, self.widen(scene.agents)))
        x = others(x + self.others(x))
        x = ego(x + self.ego(x, self.widen(scene.ego)))
        x = feed(x + self.feed_forward(x))
        imitation = None if self.imitation is None else self.imitation(x).squeeze(-1)
        return Scored(x, torch.cat([head(x) for head in self.heads], -1), imitation, self.weight)


class ToldMotion(nn.Module):
    """Adds to candidates how they go on from the ego's motion; without `ego_motion`, nothing."""

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        width = config.scorer_width
        self.embed = (
            nn.Sequential(nn.Linear(MOTION_FEATURES, width), nn.ReLU(), nn.Linear(width, width))
            if config.ego_motion
            else None
        )

    def forward(self, x: Tensor, candidates: Tensor, motion: Tensor | None) -> Tensor:
        """x: [B, M, F]; candidates: [B, M, T, 3]; motion: [B, 4] of the ego"""
        if self.embed is None:
            return x
        assert motion is not None  # as `Perception` tells it
        return x + self.embed(motion_features(candidates, motion))


class SeenUnder(nn.Module):
    """Adds to candidates what the BEV shows under the car in each of their poses, and halfway to
    it; without `footprint`, nothing.
    """

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        self.footprint = None
        if config.footprint:
            channels, backbone = config.backbone.bev_channels, config.backbone
            self.values = BevValues(config.width, channels, kernel=1)
            self.footprint = Footprint(
                channels,
                config.scorer_width,
                steps=2 * POSES,
                places=config.footprint,
                reach=backbone.lidar_range,
                ahead=config.bev_ahead,
            )

    def forward(self, x: Tensor, poses: Tensor, bev: Tensor) -> Tensor:
        """x: [B, M, F]; poses: [B, M, T, 3]; bev: [B, W, H, H]"""
        if self.footprint is None:
            return x
        return x + self.footprint(self.values(bev), halved(poses))


def encounters(config: DiffusionDriveConfig) -> Encounters | None:
    """Return the occupancy lookup of a scorer, with `encounters`."""
    if not config.encounters:
        return None
    width = config.scorer_width
    return Encounters(
        width,
        hidden=width // 3,
        steps=POSES,
        step_s=STEP_S,
        places=config.encounters,
        backbone=config.backbone,
    )


def met(encounters: Encounters | None, x: Tensor, poses: Tensor, foretold: Tensor | None) -> Tensor:
    """x [B, M, F], and who is met in poses [B, M, T, 3] where that is foretold."""
    if encounters is None:
        return x
    assert foretold is not None  # as `Perception` tells it
    return encounters(x, poses, foretold)


class CoarseScorer(nn.Module):
    """One layer over all candidates."""

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        width = config.scorer_width
        self.embed = nn.Sequential(
            nn.Linear(POSES * (POINT_FEATURES + HEADING_FEATURES), width),
            nn.ReLU(),
            nn.Linear(width, width),
        )
        self.motion, self.under = ToldMotion(config), SeenUnder(config)
        self.met = encounters(config)
        self.layer = ScorerLayer(config)

    def forward(self, candidates: Tensor, scene: SceneFeatures) -> Scored:
        """candidates: [B, M, T, 3]"""
        x = self.motion(self.embed(embedded_poses(candidates)), candidates, scene.motion)
        x = met(self.met, self.under(x, candidates, scene.bev), candidates, scene.foretold)
        return self.layer(x, candidates[..., :2], scene)


class FineScorer(nn.Module):
    """Some layers over the few best, which go on from what the coarse scorer made of them."""

    def __init__(self, config: DiffusionDriveConfig) -> None:
        super().__init__()
        self.motion, self.under = ToldMotion(config), SeenUnder(config)
        self.met = encounters(config)
        self.layers = nn.ModuleList(ScorerLayer(config) for _ in range(config.fine_layers))
        self.driven = config.driven

    def forward(self, candidates: Tensor, features: Tensor, scene: SceneFeatures) -> list[Scored]:
        """candidates: [B, M, T, 3]; features: [B, M, F] -> one a layer, of which the last counts"""
        made = []
        features = self.motion(features, candidates, scene.motion)
        poses = candidates
        if self.driven:
            assert scene.motion is not None  # as `Perception` tells it
            poses = driven_by_car(candidates, scene.motion, dt=STEP_S)
        features = self.under(features, poses, scene.bev)
        features = met(self.met, features, poses, scene.foretold)
        for layer in self.layers:
            scored = layer(features, candidates[..., :2], scene)
            features = scored.features
            made.append(scored)
        return made
