"""What DiffusionDriveV2 learns: to denoise, to score what it denoises, and to prefer what scores.

Three stages, each initialised with the weights of the one before, and one that joins two:

    imitation       perception and denoiser: the anchor nearest to the record, moved onto it
    scorers         both scorers: PDM sub-scores of the candidates that the denoiser makes
    together        both at once, so that perception learns from the scorers too
    reinforcement   the denoiser: of each anchor's samples, those that score above its others
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.diffusiondrive import DiffusionDriveV2, PerceivedScene
from anchorflow_models.diffusiondrive.config import SCHEDULES, TRAINED_LEVELS
from anchorflow_models.diffusiondrive.denoiser import Denoised, SceneFeatures
from anchorflow_models.diffusiondrive.scorers import Scored
from anchorflow_models.sub_scores import pdm_score
from anchorflow_training.driving.losses import (
    FAILED,
    PerceptionWeights,
    advantages,
    by_shares,
    distances,
    likeness_loss,
    perception_terms,
    pose_distance,
    shares,
    sub_score_loss,
    wrong_order,
)
from anchorflow_training.driving.pdm_judge import Judge, judged
from anchorflow_training.driving.sensor_windows import sensors_of
from anchorflow_training.settings import setting
from anchorflow_trajectory.ode.ddim import ddim_step, noised

Terms = dict[str, Tensor]
SPEED, ALONG, ACROSS = 4, 6, 7
"""Indices of the ego status: speed and acceleration forward, acceleration to the left."""
SCORED = ("scorers", "together")  # stages in which the scorers learn
OTHER_SPEEDS = 0.5  # share of the windows in which `speed` changes the ego's
LEAST_WAY = 1.0  # m, which the spread of a sample is in proportion to at least


@dataclass(frozen=True)
class DiffusionDriveObjectiveConfig(PerceptionWeights):
    """The stage, the weights of its terms, and how many trajectories it looks at."""

    stage: Literal["imitation", "scorers", "together", "reinforcement"] = setting(
        "imitation", "What is learnt; each stage begins with a checkpoint of the one before."
    )
    classes: float = setting(1.0, "Which anchor is the one.", ge=0)
    poses: float = setting(8.0, "L1 of its poses.", ge=0)
    coarse: float = setting(1.0, "Of the coarse scorer.", ge=0)
    fine: float = setting(1.0, "Of each layer of the fine scorer.", ge=0)
    imitation: float = setting(
        1.0, "Of which candidate a person would drive, where the model has a head for it.", ge=0
    )
    reinforcement: float = setting(1.0, "Of the policy gradient.", ge=0)
    groups: int = setting(0, "Of anchors that the scorers learn from; 0: the model's.", ge=0)
    speed: float = setting(
        0.0,
        "m/s, spread of what the ego's speed is changed by in half of the scorers' windows.",
        ge=0,
    )
    acceleration: float = setting(
        0.0, "m/s², spread of what is added to the acceleration that is told.", ge=0
    )
    levels: int = setting(
        TRAINED_LEVELS, "Of noise, below which the denoiser learns.", ge=1, le=1000
    )
    judged: int = setting(
        64, "Candidates a scene whose PDM score is worked out; at most half are the best.", ge=2
    )
    group: int = setting(4, "Samples of an anchor that are compared.", ge=2)
    exploration: float = setting(0.1, "Spread of a sample's factors on x and on y.", gt=0)


class DiffusionDriveObjective(nn.Module):
    """Loss and its terms on a batch; `judge` is asked in all stages but the first."""

    def __init__(
        self,
        model: DiffusionDriveV2,
        config: DiffusionDriveObjectiveConfig,
        judge: Judge | None = None,
    ) -> None:
        super().__init__()
        if judge is None and config.stage != "imitation":
            raise ValueError(f"judge: expected one for the stage {config.stage!r}, got None")
        self.model, self.config, self.judge = model, config, judge

    def draw(self, scenes: int, samples: int, generator: torch.Generator) -> tuple[Tensor, ...]:  # noqa: ARG002
        """Noise [B, A G, T, 2], levels [B], diversity [B, A G, V, 2], order of candidates [B, M],
        and what the status is changed by [B, 4]: normal, of speed and accelerations, and uniform.

        G and V are 1 where only anchors are denoised, the group of reinforcement, or the model's.
        """
        model = self.model.config
        scored = (self.config.groups or model.groups, model.variants)
        groups, variants = {
            "imitation": (1, 1),
            "scorers": scored,
            "together": scored,
            "reinforcement": (self.config.group, 1),
        }[self.config.stage]
        count = model.anchors * groups
        shape = (scenes, count, *self.model.anchors.shape[1:])
        candidates = count * variants + model.vocabulary
        return (
            torch.randn(shape, generator=generator),
            torch.randint(0, self.config.levels, (scenes,), generator=generator),
            torch.randn(scenes, count, variants, 2, generator=generator),
            torch.rand(scenes, candidates, generator=generator),
            torch.cat(
                [
                    torch.randn(scenes, 3, generator=generator),
                    torch.rand(scenes, 1, generator=generator),
                ],
                -1,
            ),
        )

    def forward(
        self,
        batch: Mapping[str, Tensor],
        noise: Tensor,
        level: Tensor,
        diversity: Tensor,
        order: Tensor,
        change: Tensor,
    ) -> tuple[Tensor, Terms]:
        """batch: camera, lidar, ego_status, lidar_before as of `Perception`; future [B, T, 3] m and
        rad, to imitate where is_example [B] is 1; agents [B, Q, 5], agent_velocity [B, Q, 2] and
        agent_count [B]; semantics [B, H/2, H] classes; occupancy [B, T, H/4, H/4] 0 or 1; for a
        model that compares two sweeps also lidar_randomised as lidar_before and randomised_velocity
        as
        agent_velocity, and far_others, far_velocity and far_count, as those of agents, of who is
        far ahead; window [B], for the judge; signs [B, 3] of its poses, which reflect a window that
        was reflected."""
        config, anchors = self.config, self.model.config.anchors
        status, speeds = self._changed(batch["ego_status"], change)
        sensors = {**sensors_of(batch), "ego_status": status}
        learns = config.stage != "scorers"
        if not learns:
            self.model.perception.eval()  # its normalisation does not learn either
        with torch.set_grad_enabled(learns):
            seen = self.model.perception(**sensors)
        terms: Terms = {}
        if learns:
            terms |= self._imitation(seen, batch, noise[:, :anchors], level, speeds)
        if config.stage in SCORED:
            terms |= self._scorers(seen, batch, noise, diversity, order, speeds)
        if config.stage == "reinforcement":
            terms |= self._reinforcement(seen, batch, noise, diversity[:, :, 0])
        return config.total(terms), terms

    def _changed(self, status: Tensor, change: Tensor) -> tuple[Tensor, Tensor]:
        """Return the changed status [B, 8], and the changed speeds [B], NaN for recorded ones."""
        config, status = self.config, status.clone()
        speeds = torch.full_like(status[:, 0], torch.nan)
        if config.stage in SCORED and config.speed:
            other = change[:, 3] < OTHER_SPEEDS
            before = status[:, SPEED]
            after = (before + config.speed * change[:, 0]).clamp(min=0.0)
            speeds = torch.where(other, after, speeds)
            # On the same curve.
            turn = (after / before.clamp(min=1.0)).square().where(other, torch.ones_like(after))
            status[:, SPEED] = torch.where(other, after, before)
            status[:, ACROSS] *= turn
        status[:, ALONG:] += config.acceleration * change[:, 1:3]
        return status, speeds

    def _imitation(
        self,
        seen: PerceivedScene,
        batch: Mapping[str, Tensor],
        noise: Tensor,
        level: Tensor,
        speeds: Tensor,
    ) -> Terms:
        model, future = self.model, batch["future"]
        signal = torch.as_tensor(model.config.noise_levels.signal).to(noise)[level]
        x_t = noised(begun(model, groups=1), noise, signal[:, None, None, None])
        winner = self.nearest(future)
        rows = torch.arange(len(winner), device=winner.device)
        share = examples(batch, speeds)
        classes, poses = [], []
        for made in model.denoiser(x_t, level.to(noise.dtype), seen.scene):
            classes.append(by_shares(share, F.cross_entropy(made.logits, winner, reduction="none")))
            poses.append(by_shares(share, pose_distance(made.trajectories[rows, winner], future)))
        perception = model.perception
        return {
            "classes": torch.stack(classes).mean(),
            "poses": torch.stack(poses).mean(),
            **perception_terms(
                seen, batch, sweeps=perception.sweeps, backbone=model.config.backbone
            ),
        }

    def nearest(self, future: Tensor) -> Tensor:
        """[B]: the anchor whose points lie nearest to those of the record."""
        apart = (self.model.anchors - future[:, None, :, :2]).norm(dim=-1).mean(-1)
        return apart.argmin(-1)

    def _scorers(
        self,
        seen: PerceivedScene,
        batch: Mapping[str, Tensor],
        noise: Tensor,
        diversity: Tensor,
        order: Tensor,
        speeds: Tensor,
    ) -> Terms:
        model, scene = self.model, seen.scene
        with torch.no_grad():
            diversity = diversity.clone()
            diversity[:, :, 0] = 0.0  # as the sampler has it
            candidates = model.candidates(denoised(model, scene, noise).trajectories, diversity)
        coarse = model.coarse_scorer(candidates, scene)
        # The best by the coarse scorer's own choice, as the service keeps them, and others.
        keep = min(model.config.keep, self.config.judged // 2, candidates.shape[1])
        best = coarse.scores.detach().argsort(-1, descending=True)[:, :keep]
        chosen = order.scatter(1, best, -1.0).argsort(-1)[:, keep : self.config.judged]
        chosen = torch.cat([best, chosen], 1)[..., None]
        truth = self._judged(batch, torch.take_along_dim(candidates, chosen[..., None], 1), speeds)
        logits = torch.take_along_dim(coarse.logits, chosen, 1)
        kept, true_of_kept = chosen[:, :keep], truth[:, :keep]
        fine = model.fine_scorer(
            torch.take_along_dim(candidates, kept[..., None], 1),
            torch.take_along_dim(coarse.features, kept, 1),
            scene,
        )
        misses = [sub_score_loss(s.logits, true_of_kept) for s in fine]
        score, choice = pdm_score(truth), fine[-1].scores.detach().argmax(-1, keepdim=True)
        coarse_scores = pdm_score(logits.sigmoid())
        apart = distances(candidates, batch["future"])
        ranks = [wrong_order(coarse_scores, score)]
        ranks += [wrong_order(pdm_score(s.logits.sigmoid()), pdm_score(true_of_kept)) for s in fine]
        return {
            **self._likeness(coarse, fine, apart, kept[..., 0], examples(batch, speeds)),
            "coarse": sub_score_loss(logits, truth),
            "fine": torch.stack(misses).mean(),
            "rank": torch.stack(ranks).mean(),
            "pdms_best": score.amax(-1).mean(),
            "pdms_coarse": score[:, 0].mean(),
            "pdms_fine": pdm_score(true_of_kept).gather(1, choice).mean(),
        }

    def _likeness(
        self, coarse: Scored, fine: Sequence[Scored], apart: Tensor, kept: Tensor, share: Tensor
    ) -> Terms:
        """Return the term `imitation`, if the scorers have heads for it.

        apart: [B, M] m from the record; kept: [B, K] of them that are scored finely
        share: [B] of the windows in the loss
        """
        judged = [(coarse, apart), *((scored, apart.gather(1, kept)) for scored in fine)]
        losses = [
            by_shares(share, likeness_loss(scored.imitation, distance, over=self.config.likeness))
            for scored, distance in judged
            if scored.imitation is not None
        ]
        return {"imitation": torch.stack(losses).mean()} if losses else {}

    def _reinforcement(
        self, seen: PerceivedScene, batch: Mapping[str, Tensor], noise: Tensor, factors: Tensor
    ) -> Terms:
        """The last step as a policy: a Gaussian about its poses, as wide as they are long."""
        made = denoised(self.model, seen.scene, noise).trajectories
        mean = made[..., :2]
        spread = self.config.exploration
        sample = mean.detach() * (1 + spread * factors[:, :, None])
        with torch.no_grad():
            poses = torch.cat([sample, made[..., 2:]], -1)
            poses = self.model.variants(poses, torch.zeros_like(factors)[:, :, None])
            truth = self._judged(batch, poses, torch.full_like(factors[:, 0, 0], torch.nan))
            advantage = advantages(truth, self.model.config.anchors)
        width = spread * mean.detach().norm(dim=-1, keepdim=True).clamp(min=LEAST_WAY)
        likely = -0.5 * ((sample - mean) / width).square().sum(-1).mean(-1)
        return {
            "reinforcement": -(advantage * likely).mean(),
            "pdms": pdm_score(truth).mean(),
            "failed": (advantage == FAILED).float().mean(),
        }

    def _judged(self, batch: Mapping[str, Tensor], trajectories: Tensor, speeds: Tensor) -> Tensor:
        assert self.judge is not None  # as the constructor found
        return judged(self.judge, batch, trajectories, speeds)


def examples(batch: Mapping[str, Tensor], speeds: Tensor) -> Tensor:
    """Weights [B] of windows in what is imitated, which sum to 1 or are all 0.

    At another speed something else would have been driven: it counts for nothing.
    speeds: [B] m/s, NaN as recorded
    """
    return shares(speeds.isnan() * batch["is_example"])


def begun(model: DiffusionDriveV2, *, groups: int) -> Tensor:
    """The anchors of all groups [1, A G, T, 2] in the diffusion's units, before any noise."""
    anchors = model.denoiser.space.normalised(model.anchors)
    return anchors[None].repeat(1, groups, 1, 1)


def denoised(model: DiffusionDriveV2, scene: SceneFeatures, noise: Tensor) -> Denoised:
    """Sample as the card does from noise [B, A G, T, 2]; the last step alone has gradients."""
    *before, last = SCHEDULES[model.config.steps]
    begin = begun(model, groups=noise.shape[1] // len(model.anchors))
    signal = model.config.noise_levels.signal
    x = noised(begin, noise, float(signal[model.config.start]))
    with torch.no_grad():
        for level, after in pairwise((*before, last)):
            made = model.denoiser(x, torch.full((1,), float(level), device=x.device), scene)[-1]
            x_0 = model.denoiser.space.normalised(made.trajectories[..., :2])
            x = ddim_step(x, x_0, float(signal[level]), following=float(signal[after]))
    return model.denoiser(x, torch.full((1,), float(last), device=x.device), scene)[-1]
