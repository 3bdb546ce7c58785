"""WoTE: anchors judged by what a latent world model imagines of each (Li et al., 2025).

encode     camera, LiDAR, ego status -> BEV tokens, ego, fine BEV, others; agents and semantics
score      BEV tokens, ego, fine BEV, others -> anchors moved by their offsets, rewards, scores
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from anchorflow_models.layers.attention import Decoder, EncoderLayer
from anchorflow_models.layers.geometry import standing_still
from anchorflow_models.transfuser import (
    GROUND_WIDTH,
    MOTION,
    STATUS,
    STATUS_UNITS,
    AgentHead,
    BevValues,
    Encounters,
    FarSight,
    FeaturePyramid,
    Footprint,
    GroundSemanticHead,
    GroundSight,
    OccupancyHead,
    SemanticHead,
    SweepMotion,
    TransfuserBackbone,
    driven_by_car,
    foretold_traffic,
    moved_ahead,
)
from anchorflow_models.wote.config import WoteConfig
from anchorflow_models.wote.stages import Judged, Moved, Seen, arcs, cells
from anchorflow_models.wote.world_model import RewardHead, WorldModel, final_scores

POSE = 3
OFFSET_UNITS = (1.0, 1.0, 0.1)  # m, m, rad

Context = dict[str, Tensor]


class WoTE(nn.Module):
    """anchors: [K, T, 3] poses in the ego's frame, m and rad
    anchor_remainder: [K, W] added to the encoded anchors; 0, but for weights read from a bundle,
        which has the encoded anchors without their encoder
    """

    anchors: Tensor
    anchor_remainder: Tensor
    status_units: Tensor
    offset_units: Tensor

    def __init__(self, config: WoteConfig) -> None:
        super().__init__()
        self.config = config
        width, heads, hidden, backbone = config.width, config.heads, config.hidden, config.backbone
        poses, tokens = config.num_steps * POSE, backbone.bev_size**2
        self.register_buffer("anchors", arcs(config.anchors, steps=config.num_steps, dt=config.dt))
        self.register_buffer("anchor_remainder", torch.zeros(config.anchors, width))
        for name, units in (("status_units", STATUS_UNITS), ("offset_units", OFFSET_UNITS)):
            self.register_buffer(name, torch.tensor(units), persistent=False)

        self.backbone = TransfuserBackbone(backbone)
        self.to_bev = nn.Conv2d(backbone.bev_width, width, 1)
        self.keys = nn.Parameter(0.02 * torch.randn(1, tokens, width))
        self.to_ego = nn.Linear(STATUS, width)

        self.queries = nn.Parameter(torch.randn(1, config.agents, width))
        self.agent_decoder = Decoder(width, heads, hidden=hidden, layers=config.agent_layers)
        self.agent_head = AgentHead(width, hidden, reach=backbone.lidar_range)
        classes, channels = config.semantic_classes, backbone.bev_channels
        self.ground: GroundSight | None = None
        self.semantics: SemanticHead | GroundSemanticHead
        self.future_semantics: SemanticHead | GroundSemanticHead | None = None
        if config.ground_sight:
            self.ground, pooled = GroundSight(backbone), backbone.upscaled_size // backbone.bev_size
            self.ground_tokens = nn.Conv2d(GROUND_WIDTH, width, pooled, pooled)
            self.semantics = GroundSemanticHead(backbone, GROUND_WIDTH, classes)
            self.future_semantics = GroundSemanticHead(backbone, channels, classes)
        else:
            self.semantics = SemanticHead(backbone, classes)
            if not config.shared_future:
                self.future_semantics = SemanticHead(backbone, classes)
        self.future_pyramid = FeaturePyramid(width, backbone)

        self.to_anchor = _mlp(poses, width, width)
        self.anchor_encoder = nn.Sequential(
            *[EncoderLayer(width, heads, hidden=hidden) for _ in range(config.anchor_layers)]
        )
        self.with_anchor = _mlp(2 * width, width, width)
        self.offset_decoder = Decoder(width, heads, hidden=hidden, layers=config.offset_layers)
        self.to_offset, self.to_offset_score = _mlp(width, hidden, poses), _mlp(width, hidden, 1)

        self.world_model = WorldModel(
            width,
            heads,
            hidden=hidden,
            layers=config.world_layers,
            cells=0 if config.shared_future else tokens,
            steps=config.future_steps,
        )
        seen = config.future_steps if config.rewards_of_all_steps else 1
        self.rewards = RewardHead(width, backbone.bev_size, futures=seen)
        self._add_lookups(config)

    def _add_lookups(self, config: WoteConfig) -> None:
        """What rewards look up in the fine BEV, and what foretells others."""
        width, backbone, channels = config.width, config.backbone, config.backbone.bev_channels
        if config.footprint:
            seen = channels + (GROUND_WIDTH if config.ground_sight else 0)
            self.fine_values = BevValues(seen, channels, kernel=1)
            self.footprint = Footprint(
                channels,
                width,
                steps=config.num_steps,
                places=config.footprint,
                reach=backbone.lidar_range,
                ahead=config.bev_ahead,
            )
        self.occupancy = OccupancyHead(channels, config.num_steps)
        self.sweeps: SweepMotion | None = None
        self.far: FarSight | None = None
        if config.encounters:
            self.sweeps, self.far = SweepMotion(backbone), FarSight(backbone)
            self.met = Encounters(
                width,
                hidden=width // 2,
                steps=config.num_steps,
                step_s=config.dt,
                places=config.encounters,
                backbone=backbone,
            )

    @property
    def context_for_score(self) -> tuple[str, ...]:
        """What `score` takes of what `encode` gives, in its order."""
        fine = ("bev_fine",) if self.config.footprint else ()
        foretold = ("foretold",) if self.config.encounters else ()
        motion = ("ego_motion",) if self.config.driven else ()
        return ("bev_tokens", "ego", *fine, *foretold, *motion)

    def set_anchors(self, anchors: Tensor) -> None:
        """Take other anchors [K, T, 3]. Raises ValueError where their shape is another."""
        if anchors.shape != self.anchors.shape:
            wanted, came = [*self.anchors.shape], [*anchors.shape]
            raise ValueError(f"anchors: expected shape {wanted}, got {came}")
        self.anchors.copy_(anchors)
        self.anchor_remainder.zero_()

    def encode(
        self,
        camera: Tensor,
        lidar: Tensor,
        ego_status: Tensor,
        lidar_before: Tensor | None = None,
    ) -> Context:
        """camera: uint8 [B, 3, H, W]; lidar: [B, 1, H', H'] in [0, 1]; ego_status: [B, 8];
        lidar_before: as lidar, for a backbone that reads it.

        Returns by name: bev_tokens [B, M, W], ego [B, W], bev_fine [B, h, h, C] where there are
        footprints, foretold [B, L, H', H] where there are encounters, ego_motion [B, 4] where it is
        asked what is driven; agents [B, Q, 5], agent_scores [B, Q] and bev_semantics
        [B, classes, H/2, H], both in [0, 1].
        """
        seen = self.look(camera, lidar, ego_status, lidar_before)
        return {
            "bev_tokens": seen.bev,
            "ego": seen.ego,
            **({} if seen.fine is None else {"bev_fine": seen.fine}),
            **({} if seen.foretold is None else {"foretold": seen.foretold}),
            **({} if seen.motion is None else {"ego_motion": seen.motion}),
            "agents": seen.agents,
            "agent_scores": seen.agent_logits.sigmoid(),
            "bev_semantics": seen.semantics.softmax(1),
        }

    def score(
        self,
        bev_tokens: Tensor,
        ego: Tensor,
        bev_fine: Tensor | None = None,
        foretold: Tensor | None = None,
        ego_motion: Tensor | None = None,
        *,
        anchors: Tensor | None = None,
    ) -> Context:
        """bev_tokens, ego, bev_fine, foretold, ego_motion as of `encode`; anchors: [K, W] already
        encoded, if they are.

        Returns by name: trajectories [B, K', T, 3] m, m, rad; scores [B, K']; offsets [B, K', T, 3]
        from the anchors; im_rewards [B, K'], which sum to 1; sim_rewards [B, K', 5] in [0, 1]. K'
        is `config.judged`; without `kept` they are in the order of the anchors.
        """
        moved = self.move(bev_tokens, ego, anchors)
        if self.config.judged < self.config.anchors:
            moved = moved.taken(moved.logits.topk(self.config.judged).indices)
        chosen = self.anchors[moved.index]
        trajectories = standing_still(chosen + moved.offsets)
        judged = self.judge(
            bev_tokens,
            moved,
            fine=bev_fine,
            foretold=foretold,
            motion=ego_motion,
            poses=trajectories,
        )
        return {
            "trajectories": trajectories,
            "scores": final_scores(judged.imitation, judged.simulation, self.config.rewards),
            "offsets": trajectories - chosen,
            "im_rewards": judged.imitation.softmax(-1),
            "sim_rewards": judged.simulation.sigmoid(),
        }

    def look(
        self,
        camera: Tensor,
        lidar: Tensor,
        ego_status: Tensor,
        lidar_before: Tensor | None = None,
    ) -> Seen:
        """Encode the sensors; shapes as of `encode`."""
        features = self.backbone(camera, lidar, lidar_before)
        status = ego_status / self.status_units
        tokens, fine = self.to_bev(features.features), features.upscaled
        looked_up = fine
        if self.ground is not None:
            fine = moved_ahead(fine, self.config.backbone.ground_rows)
            ground = self.ground(camera, fine, status)
            tokens = moved_ahead(tokens, self.config.bev_rows) + self.ground_tokens(ground)
            fine, looked_up = torch.cat([fine, ground], 1), ground
        bev = tokens.flatten(2).transpose(1, 2) + self.keys
        sensors = (camera, lidar, lidar_before)
        moving, far, foretold = foretold_traffic(
            self.sweeps, self.far, sensors, features.upscaled, self.config.foretold_times
        )
        queries = self.agent_decoder(self.queries.expand(bev.shape[0], -1, -1), bev)
        agents, agent_logits = self.agent_head(queries)
        return Seen(
            agents=agents,
            agent_logits=agent_logits,
            semantics=self.semantics(looked_up),
            occupancy=self.occupancy(features.upscaled),
            upscaled=features.upscaled,
            moving=moving,
            far=far,
            bev=bev,
            ego=self.to_ego(status),
            fine=self.fine_values(fine) if self.config.footprint else None,
            motion=ego_status[:, MOTION] if self.config.driven else None,
            foretold=foretold,
        )

    def encoded_anchors(self) -> Tensor:
        """[K, W] what the anchors are, which no scene changes."""
        scale = torch.tensor([*[1 / self.config.backbone.lidar_range] * 2, 1.0])
        poses = (self.anchors * scale.to(self.anchors)).flatten(1)
        return self.anchor_encoder(self.to_anchor(poses)[None])[0] + self.anchor_remainder

    def _load_from_state_dict(
        self, state_dict: dict[str, Any], prefix: str, *rest: Any, **how: Any
    ) -> None:
        """Load weights; those of earlier versions have no remainder."""
        state_dict.setdefault(f"{prefix}anchor_remainder", torch.zeros_like(self.anchor_remainder))
        super()._load_from_state_dict(state_dict, prefix, *rest, **how)

    def move(self, bev: Tensor, ego: Tensor, anchors: Tensor | None = None) -> Moved:
        """All anchors, moved to suit the scene.

        bev: [B, M, W]; ego: [B, W]; anchors: [K, W] as `encoded_anchors` gives them
        """
        encoded = self.encoded_anchors() if anchors is None else anchors
        batch, count = ego.shape[0], len(encoded)
        each = torch.cat([ego[:, None].expand(-1, count, -1), encoded.expand(batch, -1, -1)], -1)
        each = self.with_anchor(each)
        index = torch.arange(count, device=ego.device).expand(batch, -1)
        if not self.config.offsets:
            still = self.anchors.new_zeros(batch, *self.anchors.shape)
            return Moved(index, each, still, each.new_zeros(batch, count))
        decoded = self.offset_decoder(each, bev)
        offsets = self.to_offset(decoded).unflatten(-1, (-1, POSE)) * self.offset_units
        return Moved(index, each, offsets, self.to_offset_score(decoded).squeeze(-1))

    def judge(
        self,
        bev: Tensor,
        moved: Moved,
        *,
        fine: Tensor | None,
        foretold: Tensor | None = None,
        motion: Tensor | None = None,
        poses: Tensor | None = None,
    ) -> Judged:
        """Imagine what follows from each anchor and rate it.

        bev: [B, M, W]; fine: [B, h, h, C], which footprints look up; foretold: [B, L, H', H], which
            encounters do; motion: [B, 4] the ego's, m/s and m/s², with `driven`
        poses: [B, K', T, 3] to look up, or to track; by default the anchors' own

        Raises:
            ValueError: an input of footprints, encounters or `driven` is missing.
        """
        if fine is None and self.config.footprint:
            raise ValueError("fine: expected [B, h, h, C] for footprints, got None")
        if foretold is None and self.config.encounters:
            raise ValueError("foretold: expected [B, L, H', H] for encounters, got None")
        if motion is None and self.config.driven:
            raise ValueError("motion: expected [B, 4] to tell what is driven, got None")
        here, there = self._cells()
        keys = self.keys if self.config.shared_future else None
        ego, futures = self.world_model(
            moved.ego, bev, here=here, there=there[moved.index], keys=keys
        )
        poses = self.anchors[moved.index] if poses is None else poses
        if motion is not None:
            poses = driven_by_car(poses, motion, dt=self.config.dt)
        under = None if fine is None else self.footprint(fine, poses)
        if foretold is not None:
            under = self.met(torch.zeros_like(ego) if under is None else under, poses, foretold)
        rated = torch.cat(futures, -1) if self.config.rewards_of_all_steps else futures[-1]
        imitation, simulation = self.rewards(ego, bev, rated, under)
        return Judged(futures[-1], imitation, simulation)

    def future_semantic_logits(self, future: Tensor) -> Tensor:
        """Return the classes of an imagined BEV [B, M, W] -> [B, classes, H/2, H]; for training."""
        size = self.config.backbone.bev_size
        image = future.transpose(1, 2).unflatten(-1, (size, size))
        return (self.future_semantics or self.semantics)(self.future_pyramid(image))

    def _cells(self) -> tuple[Tensor, Tensor]:
        """One-hot: the ego's cell now [M], and on each anchor after each future step [K, n, M]."""
        backbone, steps = self.config.backbone, self.config.future_steps
        last = torch.arange(1, steps + 1) * self.config.num_steps // steps - 1
        places = self.anchors[:, last.clamp(min=0), :2]
        size, reach, ahead = backbone.bev_size, backbone.lidar_range, self.config.bev_ahead
        here = cells(places.new_zeros(2), size=size, reach=reach, ahead=ahead)
        return here, cells(places, size=size, reach=reach, ahead=ahead)


def create_wote(config: WoteConfig) -> WoTE:
    """A network of that configuration, its weights drawn at random."""
    return WoTE(config)


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, outputs))
