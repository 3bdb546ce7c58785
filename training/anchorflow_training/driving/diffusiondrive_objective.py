"""What DiffusionDriveV2 learns: to denoise, to score what it denoises, and to prefer what scores.

Three stages, each of which goes on from the weights of the one before:

    imitation       perception and denoiser: the anchor nearest to the record, moved onto it
    scorers         both scorers: PDM sub-scores of the candidates that the denoiser makes
    reinforcement   the denoiser: of each anchor's samples, those that score above its others
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.diffusiondrive import DiffusionDriveV2, Perceived
from anchorflow_models.diffusiondrive.config import SCHEDULES, START, TRAINED_LEVELS
from anchorflow_models.diffusiondrive.denoiser import Denoised
from anchorflow_models.diffusiondrive.scene import SceneFeatures
from anchorflow_models.diffusiondrive.scorers import pdm_score
from anchorflow_training.driving.perception_losses import agent_loss, focal_loss
from anchorflow_training.settings import setting
from anchorflow_trajectory.ddim import NoiseLevels, ddim_step, noised

Terms = dict[str, Tensor]
Judge = Callable[[Tensor, Tensor], Tensor]
"""PDM sub-scores [B, M, 5] in [0, 1] of trajectories [B, M, T, 3] in windows [B], by number."""

SIGNAL = NoiseLevels().signal
FAILED = -1.0  # the advantage of what collides or leaves the road
LEAST_SPREAD = 1e-4  # of the scores of one anchor's samples
LEAST_WAY = 1.0  # m, which the spread of a sample is in proportion to at least


@dataclass(frozen=True)
class DiffusionDriveObjectiveConfig:
    """The stage, the weights of its terms, and how many trajectories it looks at."""

    stage: Literal["imitation", "scorers", "reinforcement"] = setting(
        "imitation", "What is learnt; each stage begins with a checkpoint of the one before."
    )
    classes: float = setting(1.0, "Which anchor is the one.", least=0)
    poses: float = setting(8.0, "L1 of its poses.", least=0)
    agents: float = setting(1.0, "Of the boxes.", least=0)
    semantics: float = setting(10.0, "Of the semantic BEV.", least=0)
    coarse: float = setting(1.0, "Of the coarse scorer.", least=0)
    fine: float = setting(1.0, "Of each layer of the fine scorer.", least=0)
    reinforcement: float = setting(1.0, "Of the policy gradient.", least=0)
    judged: int = setting(
        64, "Candidates a scene whose PDM score is worked out; at most half are the best.", least=2
    )
    group: int = setting(4, "Samples of an anchor that are compared.", least=2)
    exploration: float = setting(0.1, "Spread of a sample's factors on x and on y.", above=0)


class DiffusionDriveObjective(nn.Module):
    """Loss and its terms on a batch; `judge` is asked in the two later stages."""

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
        """Noise [B, A G, T, 2], levels [B], diversity [B, A G, V, 2], order of candidates [B, M].

        G and V are 1 where only anchors are denoised, the group of reinforcement, or the model's.
        """
        model = self.model.config
        groups, variants = {
            "imitation": (1, 1),
            "scorers": (model.groups, model.variants),
            "reinforcement": (self.config.group, 1),
        }[self.config.stage]
        count = model.anchors * groups
        shape = (scenes, count, *self.model.anchors.shape[1:])
        candidates = count * variants + model.vocabulary
        return (
            torch.randn(shape, generator=generator),
            torch.randint(0, TRAINED_LEVELS, (scenes,), generator=generator),
            torch.randn(scenes, count, variants, 2, generator=generator),
            torch.rand(scenes, candidates, generator=generator),
        )

    def forward(
        self,
        batch: Mapping[str, Tensor],
        noise: Tensor,
        level: Tensor,
        diversity: Tensor,
        order: Tensor,
    ) -> tuple[Tensor, Terms]:
        """batch: camera, lidar, ego_status as of `Perception`; future [B, T, 3] m, rad; agents
        [B, Q, 5] and agent_count [B]; semantics [B, H/2, H] classes; window [B], for the judge."""
        sensors = (batch["camera"], batch["lidar"], batch["ego_status"])
        if self.config.stage == "scorers":
            self.model.perception.eval()  # it does not learn, its normalisation neither
            with torch.no_grad():
                seen = self.model.perception(*sensors)
            terms = self._scorers(seen, batch["window"], noise, diversity, order)
        else:
            seen = self.model.perception(*sensors)
            anchors = self.model.config.anchors
            terms = self._imitation(seen, batch, noise[:, :anchors], level)
            if self.config.stage == "reinforcement":
                terms |= self._reinforcement(seen, batch["window"], noise, diversity[:, :, 0])
        weighted = [
            getattr(self.config, name) * term
            for name, term in terms.items()
            if hasattr(self.config, name)
        ]
        return torch.stack(weighted).sum(), terms

    def _imitation(
        self, seen: Perceived, batch: Mapping[str, Tensor], noise: Tensor, level: Tensor
    ) -> Terms:
        model, future = self.model, batch["future"]
        signal = torch.as_tensor(SIGNAL, dtype=noise.dtype, device=noise.device)[level]
        x_t = noised(begun(model, groups=1), noise, signal[:, None, None, None])
        winner = self.nearest(future)
        rows = torch.arange(len(winner), device=winner.device)
        classes, poses = [], []
        for made in model.denoiser(x_t, level.to(noise.dtype), seen.scene):
            classes.append(F.cross_entropy(made.logits, winner))
            poses.append(pose_distance(made.trajectories[rows, winner], future).mean())
        return {
            "classes": torch.stack(classes).mean(),
            "poses": torch.stack(poses).mean(),
            "agents": agent_loss(
                seen.agents, seen.agent_logits, batch["agents"], batch["agent_count"]
            ),
            "semantics": focal_loss(seen.semantics, batch["semantics"]),
        }

    def nearest(self, future: Tensor) -> Tensor:
        """[B]: the anchor whose points lie nearest to those of the record."""
        apart = (self.model.anchors - future[:, None, :, :2]).norm(dim=-1).mean(-1)
        return apart.argmin(-1)

    def _scorers(
        self, seen: Perceived, windows: Tensor, noise: Tensor, diversity: Tensor, order: Tensor
    ) -> Terms:
        model, scene = self.model, seen.scene
        with torch.no_grad():
            diversity = diversity.clone()
            diversity[:, :, 0] = 0.0  # as the sampler has it
            candidates = model.candidates(denoised(model, scene, noise).trajectories, diversity)
        coarse = model.coarse_scorer(candidates, scene)
        # The best by the coarse scorer's own choice, as the service keeps them, and others.
        keep = min(model.config.keep, self.config.judged // 2)
        best = coarse.scores.detach().argsort(-1, descending=True)[:, :keep]
        chosen = order.scatter(1, best, -1.0).argsort(-1)[:, keep : self.config.judged]
        chosen = torch.cat([best, chosen], 1)[..., None]
        truth = self._judged(windows, torch.take_along_dim(candidates, chosen[..., None], 1))
        logits = torch.take_along_dim(coarse.logits, chosen, 1)
        kept, true_of_kept = chosen[:, :keep], truth[:, :keep]
        fine = model.fine_scorer(
            torch.take_along_dim(candidates, kept[..., None], 1),
            torch.take_along_dim(coarse.features, kept, 1),
            scene,
        )
        misses = [F.binary_cross_entropy_with_logits(s.logits, true_of_kept) for s in fine]
        score, choice = pdm_score(truth), fine[-1].scores.detach().argmax(-1, keepdim=True)
        return {
            "coarse": F.binary_cross_entropy_with_logits(logits, truth),
            "fine": torch.stack(misses).mean(),
            "pdms_best": score.amax(-1).mean(),
            "pdms_coarse": score[:, 0].mean(),
            "pdms_fine": pdm_score(true_of_kept).gather(1, choice).mean(),
        }

    def _reinforcement(
        self, seen: Perceived, windows: Tensor, noise: Tensor, factors: Tensor
    ) -> Terms:
        """The last step as a policy: a Gaussian about its poses, as wide as they are long."""
        made = denoised(self.model, seen.scene, noise).trajectories
        mean = made[..., :2]
        spread = self.config.exploration
        sample = mean.detach() * (1 + spread * factors[:, :, None])
        with torch.no_grad():
            poses = torch.cat([sample, made[..., 2:]], -1)
            poses = self.model.variants(poses, torch.zeros_like(factors)[:, :, None])
            truth = self._judged(windows, poses)
            advantage = advantages(truth, self.model.config.anchors)
        width = spread * mean.detach().norm(dim=-1, keepdim=True).clamp(min=LEAST_WAY)
        likely = -0.5 * ((sample - mean) / width).square().sum(-1).mean(-1)
        return {
            "reinforcement": -(advantage * likely).mean(),
            "pdms": pdm_score(truth).mean(),
            "failed": (advantage == FAILED).float().mean(),
        }

    def _judged(self, windows: Tensor, trajectories: Tensor) -> Tensor:
        assert self.judge is not None  # as the constructor found
        return self.judge(windows, trajectories).to(trajectories)


def begun(model: DiffusionDriveV2, *, groups: int) -> Tensor:
    """The anchors of all groups [1, A G, T, 2] in the diffusion's units, before any noise."""
    anchors = model.denoiser.space.normalised(model.anchors)
    return anchors[None].repeat(1, groups, 1, 1)


def denoised(model: DiffusionDriveV2, scene: SceneFeatures, noise: Tensor) -> Denoised:
    """What the card's sampler makes of noise [B, A G, T, 2]; gradients of its last step alone."""
    *before, last = SCHEDULES[model.config.steps]
    begin = begun(model, groups=noise.shape[1] // len(model.anchors))
    x = noised(begin, noise, float(SIGNAL[START]))
    with torch.no_grad():
        for level, after in pairwise((*before, last)):
            made = model.denoiser(x, torch.full((1,), float(level), device=x.device), scene)[-1]
            x_0 = model.denoiser.space.normalised(made.trajectories[..., :2])
            x = ddim_step(x, x_0, float(SIGNAL[level]), following=float(SIGNAL[after]))
    return model.denoiser(x, torch.full((1,), float(last), device=x.device), scene)[-1]


def advantages(sub_scores: Tensor, anchors: int) -> Tensor:
    """[B, A G] of sub-scores [B, A G, 5], groups of all anchors one after another.

    How far a sample's PDM score lies above the mean of its own anchor's, in their deviations; 0
    where it lies below, as another anchor's manner is no fault; FAILED where it collides or leaves
    the road (Zou et al., 2025: intra-anchor groups, truncated).
    """
    nc, dac = sub_scores[..., 0], sub_scores[..., 1]
    score = pdm_score(sub_scores).unflatten(1, (-1, anchors))
    above = score - score.mean(1, keepdim=True)
    relative = above / score.std(1, keepdim=True).clamp(min=LEAST_SPREAD)
    kept = relative.clamp(min=0.0).flatten(1)
    return torch.where((nc < 1) | (dac < 1), torch.full_like(kept, FAILED), kept)


def pose_distance(poses: Tensor, others: Tensor) -> Tensor:
    """Mean absolute differences [...] of poses [..., T, 3], headings the short way round."""
    apart = poses - others
    turn = torch.atan2(apart[..., 2].sin(), apart[..., 2].cos())
    return torch.cat([apart[..., :2], turn[..., None]], -1).abs().mean((-1, -2))
