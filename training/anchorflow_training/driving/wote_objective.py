"""What WoTE learns from: recorded futures, the PDM score of its anchors, boxes and semantics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_driving.importers.navsim import EGO_SIZE
from anchorflow_driving.window import REAR_AXLE
from anchorflow_models.layers.geometry import standing_still
from anchorflow_models.sub_scores import pdm_score
from anchorflow_models.wote import Moved, WoTE
from anchorflow_training.driving.labels import CLASSES
from anchorflow_training.driving.losses import (
    PerceptionWeights,
    by_shares,
    distances,
    focal_loss,
    likeness_loss,
    perception_terms,
    shares,
    sub_score_loss,
    wrong_order,
)
from anchorflow_training.driving.pdm_judge import Judge, judged
from anchorflow_training.driving.sensor_windows import sensors_of
from anchorflow_training.settings import setting

TINY = 1e-9
VEHICLE = CLASSES.index("vehicle")
BEHIND = REAR_AXLE * EGO_SIZE[0]
BEFORE = EGO_SIZE[0] - BEHIND
"""m from the rear axle to the ego's bumpers."""


@dataclass(frozen=True)
class WoteObjectiveConfig(PerceptionWeights):
    """Weights of the terms; the defaults are the published ones.

    future_anchors: anchors a scene whose imagined BEV learns semantics, the nearest to the record
        and others that are judged, each with the ego drawn at its end; 0: the nearest, without the
        ego
    judged: anchors a scene that the world model looks at in a step, the nearest to the record and
        others; 0: all
    likely: of those others, how many are drawn by their offset scores, as among them the choice
        will be; the rest is drawn evenly
    """

    offset: float = setting(1.0, "L1 of the winner's refined poses.", ge=0)
    offset_imitation: float = setting(0.1, "Of the offset scores.", ge=0)
    imitation: float = setting(1.0, "Of the imitation reward.", ge=0)
    simulation: float = setting(1.0, "Of the five simulation rewards.", ge=0)
    conditional: bool = setting(
        False, "Whether EP, TTC and C are learnt of anchors that pass NC and DAC alone."
    )
    future_semantics: float = setting(0.1, "Of the semantic BEV that is imagined.", ge=0)
    future_anchors: int = setting(
        0, "Anchors whose imagined semantics are learnt, the ego at the end of each.", ge=0
    )
    judged: int = setting(0, "Anchors that the world model looks at in a step; 0: all.", ge=0)
    likely: int = setting(0, "Of them, how many are drawn by their offset scores.", ge=0)
    moved: bool = setting(
        False, "Whether rewards learn of anchors as their offsets move them, and not before."
    )


class WoteObjective(nn.Module):
    """Loss and its terms on a batch; `judge` scores moved anchors."""

    def __init__(
        self, model: WoTE, config: WoteObjectiveConfig, judge: Judge | None = None
    ) -> None:
        super().__init__()
        if judge is None and config.moved:
            raise ValueError("judge: expected one for moved anchors, got None")
        self.model, self.config, self.judge = model, config, judge

    def draw(self, scenes: int, samples: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:  # noqa: ARG002
        """[B, K] numbers, by whose order anchors are taken, and by whose luck likely ones are."""
        shape = (scenes, self.model.config.anchors)
        return torch.rand(shape, generator=generator), torch.rand(shape, generator=generator)

    def forward(
        self, batch: Mapping[str, Tensor], order: Tensor, luck: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: camera, lidar, ego_status, lidar_before as of `WoTE.encode`; future [B, T, 3] m,
        rad, to imitate where is_example [B] is 1, and is_recorded [B]; pdm [B, K, 5] of the anchors
        in [0, 1], or window [B] and signs [B, 3], for the judge; agents [B, Q, 5] and agent_count
        [B]; semantics, future_semantics [B, H/2, H] classes; occupancy [B, T, H/4, H/4] 0 or 1;
        with encounters also what `perception_terms` takes."""
        model, config = self.model, self.config
        seen = model.look(**sensors_of(batch))
        moved = model.move(seen.bev, seen.ego)
        distance = distances(model.anchors[None], batch["future"])
        nearest = distance.argmin(-1)
        chosen = self._chosen(order, nearest, likely(moved.logits.detach(), luck))
        taken = moved.taken(chosen)
        poses, pdm = self._rated(batch, taken)
        imagined = model.judge(
            seen.bev,
            taken,
            fine=seen.fine,
            foretold=seen.foretold,
            motion=seen.motion,
            poses=poses,
        )
        winner = nearest[:, None, None, None].expand(-1, 1, *moved.offsets.shape[2:])
        refined = model.anchors[nearest] + moved.offsets.gather(1, winner)[:, 0]
        share, recorded = shares(batch["is_example"]), shares(batch["is_recorded"])
        terms = {
            "offset": by_shares(share, (refined - batch["future"]).abs().mean((1, 2))),
            "offset_imitation": by_shares(share, self._likeness(moved.logits, distance)),
            "imitation": by_shares(
                share, self._likeness(imagined.imitation, distances(poses, batch["future"]))
            ),
            "simulation": sub_score_loss(imagined.simulation, pdm)
            if config.conditional
            else F.binary_cross_entropy_with_logits(imagined.simulation, pdm),
            "future_semantics": by_shares(recorded, self._imagined(batch, imagined.future, poses)),
        }
        if config.rank:
            scores = pdm_score(imagined.simulation.sigmoid())
            terms["rank"] = wrong_order(scores, pdm_score(pdm))
        terms |= perception_terms(seen, batch, sweeps=model.sweeps, backbone=model.config.backbone)
        if not model.config.offsets:
            terms = {name: term for name, term in terms.items() if not name.startswith("offset")}
        return config.total(terms), terms

    def _imagined(self, batch: Mapping[str, Tensor], future: Tensor, poses: Tensor) -> Tensor:
        """Return the focal loss [B] of imagined semantics.

        future: [B, K', M, W] of anchors, the nearest to what was driven first, with poses
            [B, K', T, 3]
        """
        wanted, count = batch["future_semantics"], self.config.future_anchors
        if not count:
            return focal_loss(self.model.future_semantic_logits(future[:, 0]), wanted)
        imagined, ends = future[:, :count], poses[:, :count, -1]
        reach = self.model.config.backbone.lidar_range
        wanted = with_ego(wanted, ends, reach=reach).flatten(0, 1)
        logits = self.model.future_semantic_logits(imagined.flatten(0, 1))
        return focal_loss(logits, wanted).unflatten(0, ends.shape[:2]).mean(1)

    def _chosen(self, order: Tensor, nearest: Tensor, ranked: Tensor) -> Tensor:
        """[B, K'] the nearest first, then the likeliest, then others in a random order."""
        first = torch.cat([nearest[:, None], ranked[:, : self.config.likely]], 1)
        rank = order.scatter(1, first, order.gather(1, first) - 1.0)
        rank = rank.scatter(1, nearest[:, None], -2.0)
        return rank.argsort(-1)[:, : self.config.judged or None]

    def _rated(self, batch: Mapping[str, Tensor], taken: Moved) -> tuple[Tensor, Tensor]:
        """Return the judged poses of the taken anchors [B, K', T, 3], and their sub-scores."""
        anchors = self.model.anchors[taken.index]
        if not self.config.moved:
            index = taken.index[..., None].expand(-1, -1, batch["pdm"].shape[-1])
            return anchors, batch["pdm"].gather(1, index)
        assert self.judge is not None  # as the constructor found
        poses = standing_still(anchors + taken.offsets.detach())
        return poses, judged(self.judge, batch, poses)

    def _likeness(self, logits: Tensor, distance: Tensor) -> Tensor:
        """[B]"""
        return likeness_loss(logits, distance, over=self.config.likeness)


def with_ego(classes: Tensor, ends: Tensor, *, reach: float) -> Tensor:
    """Return semantic BEVs [B, n, H/2, H] with the ego drawn at poses [B, n, 3], as a vehicle.

    classes: [B, H/2, H], from the rear axle to `reach` m ahead and to either side
    """
    rows, columns = classes.shape[-2:]
    cell = reach / rows
    x = reach - cell * (torch.arange(rows, device=ends.device) + 0.5)
    y = reach - cell * (torch.arange(columns, device=ends.device) + 0.5)
    dx = x[:, None] - ends[..., 0, None, None]
    dy = y - ends[..., 1, None, None]
    cos, sin = ends[..., 2, None, None].cos(), ends[..., 2, None, None].sin()
    ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
    inside = (ahead > -BEHIND) & (ahead < BEFORE) & (left.abs() < EGO_SIZE[1] / 2)
    return torch.where(inside, VEHICLE, classes[:, None])


def likely(logits: Tensor, luck: Tensor) -> Tensor:
    """Draws [B, K] without replacement by scores, the first drawn first: the Gumbel-max trick.

    logits: [B, K]; luck: [B, K] even in [0, 1)
    """
    return (logits - luck.clamp(min=TINY).log().neg().log()).argsort(-1, descending=True)
