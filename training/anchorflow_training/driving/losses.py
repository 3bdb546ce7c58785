"""Losses and distances that the planners on driving logs share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor
from torch.nn import functional as F

from anchorflow_models.sub_scores import pdm_score
from anchorflow_models.transfuser import (
    LIDAR_BEFORE,
    Moving,
    Perceived,
    SweepMotion,
    TransfuserConfig,
)
from anchorflow_training.driving.sensor_windows import LIDAR_RANDOMISED
from anchorflow_training.settings import setting


def distances(trajectories: Tensor, future: Tensor) -> Tensor:
    """Mean distance [B, M] in m of trajectories [B or 1, M, T, 3] from futures [B, T, 3]."""
    return (trajectories[..., :2] - future[:, None, :, :2]).norm(dim=-1).mean(-1)


def shares(counted: Tensor) -> Tensor:
    """Weights [B] of windows in a mean: alike where one is counted, 1, and not 0; they sum to 1,
    or are all 0.
    """
    return counted / counted.sum().clamp(min=1.0)


def by_shares(share: Tensor, losses: Tensor) -> Tensor:
    """The mean of losses [B] by shares [B]; no product, which autocast would round."""
    return (share * losses).sum()


def likeness_loss(logits: Tensor, distance: Tensor, *, over: float) -> Tensor:
    """Return the cross-entropy [B] of logits [B, M] with soft labels, which fall by e over `over`
    m.
    """
    labels = (-distance / over).softmax(-1)
    return -(labels * logits.log_softmax(-1)).sum(-1)


SHARPNESS = 0.05  # scale of scores that distinguish trajectories


def sub_score_loss(logits: Tensor, truth: Tensor) -> Tensor:
    """Binary cross-entropy of sub-scores [B, M, 5] in the order of SUB_SCORES, or [B, M, 6] with
    DDC, each by what it counts: EP, TTC and C by NC x DAC, as the PDM score multiplies.

    Of what collides the score is 0 however far it came. Heads that learnt that too would count
    every risk twice, once by NC and again by EP and TTC, and prefer whatever creeps. Learnt so,
    NC DAC (5 EP + 5 TTC + 2 C) / 12 of what they foretell is the score to be expected.
    """
    losses = F.binary_cross_entropy_with_logits(logits, truth, reduction="none")
    counts = torch.ones_like(truth)
    counts[..., 2:5] = truth[..., :1] * truth[..., 1:2]
    return ((losses * counts).sum((0, 1)) / counts.sum((0, 1)).clamp(min=1.0)).mean()


def wrong_order(scores: Tensor, worth: Tensor) -> Tensor:
    """Logistic loss of all pairs of scores [B, M], each by how far apart they are worth [B, M]."""
    above = (worth[:, :, None] - worth[:, None]).clamp(min=0.0)
    apart = (scores[:, :, None] - scores[:, None]) / SHARPNESS
    return (above * F.softplus(-apart)).sum() / above.sum().clamp(min=1.0)


FAILED = -1.0  # the advantage of what collides or leaves the road
LEAST_SPREAD = 1e-4  # of the scores of one anchor's samples


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
    return _apart(poses, others).mean((-1, -2))


HEADING = 2  # of x, y, heading, length, width
MOVES = 0.5  # m/s
MOVING = 4.0  # times what the velocity of something at rest weighs
CLOSE = 0.3  # m/s, below which smooth L1 is a square
THERE = 5.0  # weight of occupancy relative to velocities


def focal_loss(logits: Tensor, classes: Tensor) -> Tensor:
    """-0.5 (1 - p)² log p of the true class [B], the mean over its cells (Lin et al., 2017).

    logits: [B, classes, H, W]; classes: integers [B, H, W]
    """
    log_p = logits.log_softmax(1).gather(1, classes.long()[:, None])[:, 0]
    return -(0.5 * (1 - log_p.exp()).pow(2.0) * log_p).mean((1, 2))


def occupancy_loss(logits: Tensor, occupied: Tensor) -> Tensor:
    """Binary cross-entropy, its mean; logits: [B, T, H, H]; occupied: 0 or 1 likewise."""
    return F.binary_cross_entropy_with_logits(logits, occupied.to(logits.dtype))


def motion_loss(
    moving: Moving, boxes: Tensor, velocity: Tensor, count: Tensor, *, cell: float, ahead: float
) -> Tensor:
    """Of which cells others are in, binary cross-entropy, and of how fast, smooth L1.

    boxes: [B, Q, 5] m, rad; velocity: [B, Q, 2] m/s; the first count [B] are there
    cell: m, a side of the cells, whose columns lie about the ego's line; ahead: m, their first edge
    """
    rows, columns = moving.there.shape[-2:]
    x = ahead - cell * (torch.arange(rows, device=boxes.device) + 0.5)
    y = cell * (columns / 2 - 0.5 - torch.arange(columns, device=boxes.device))
    inside = _inside(boxes, count, x, y)
    taken = inside.any(1)
    told = F.binary_cross_entropy_with_logits(moving.there, taken.to(moving.there))
    of = inside.to(velocity).argmax(1).flatten(1)[..., None].expand(-1, -1, 2)
    true = velocity.gather(1, of).transpose(1, 2).unflatten(-1, tuple(taken.shape[1:]))
    apart = F.smooth_l1_loss(moving.velocity, true, reduction="none", beta=CLOSE).sum(1)
    weight = taken * (1 + (MOVING - 1) * (true.norm(dim=1) > MOVES))
    return (weight * apart).sum() / weight.sum().clamp(min=1.0) + THERE * told


@dataclass(frozen=True)
class PerceptionWeights:
    """Weights of the terms that every planner with a Transfuser backbone learns from."""

    agents: float = setting(1.0, "Of the boxes.", ge=0)
    semantics: float = setting(10.0, "Of the semantic BEV.", ge=0)
    occupancy: float = setting(0.0, "Of where others will be; published has none.", ge=0)
    motion: float = setting(
        0.5, "Of how fast others move, where the model compares two sweeps.", ge=0
    )
    far: float = setting(
        0.5, "Of who is beyond the LiDAR's square, where the model looks there.", ge=0
    )
    likeness: float = setting(1.0, "m, over which a trajectory's soft label falls by e.", gt=0)
    rank: float = setting(0.0, "Of pairs of trajectories in the wrong order.", ge=0)

    def total(self, terms: Mapping[str, Tensor]) -> Tensor:
        """The weighted sum of the terms that have a weight."""
        weighted = [getattr(self, n) * term for n, term in terms.items() if hasattr(self, n)]
        return torch.stack(weighted).sum()


def perception_terms(
    seen: Perceived,
    batch: Mapping[str, Tensor],
    *,
    sweeps: SweepMotion | None,
    backbone: TransfuserConfig,
) -> dict[str, Tensor]:
    """The terms `agents`, `semantics` and `occupancy`; `motion` and `far` if sweeps are compared.

    batch: as of `SensorWindows`; without lidar_before, `motion` learns from randomised motion alone
    """
    terms = {
        "agents": agent_loss(seen.agents, seen.agent_logits, batch["agents"], batch["agent_count"]),
        "semantics": focal_loss(seen.semantics, batch["semantics"]).mean(),
        "occupancy": occupancy_loss(seen.occupancy, batch["occupancy"]),
    }
    if sweeps is None:
        return terms
    assert seen.moving is not None
    assert seen.far is not None
    cell, reach = backbone.upscaled_cell, backbone.lidar_range
    chance = sweeps(batch["lidar"], batch[LIDAR_RANDOMISED], seen.upscaled)
    learnt = [(chance, batch["randomised_velocity"])]
    if LIDAR_BEFORE in batch:
        learnt.append((seen.moving, batch["agent_velocity"]))
    boxes, count = batch["agents"], batch["agent_count"]
    losses = [
        motion_loss(each, boxes, true, count, cell=cell, ahead=reach) for each, true in learnt
    ]
    others = (batch["far_others"], batch["far_velocity"], batch["far_count"])
    beyond = motion_loss(seen.far, *others, cell=cell, ahead=reach + backbone.far_range)
    return {**terms, "motion": torch.stack(losses).mean(), "far": beyond}


def _inside(boxes: Tensor, count: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """[B, Q, rows, columns]: whether a box contains the middle of a cell, at x [rows] and y
    [columns].
    """
    middle_x, middle_y, heading, length, width = (
        each[..., None, None] for each in boxes.unbind(-1)
    )
    forward, left = x[:, None] - middle_x, y - middle_y
    along = forward * heading.cos() + left * heading.sin()
    across = left * heading.cos() - forward * heading.sin()
    there = torch.arange(boxes.shape[1], device=boxes.device) < count[:, None]
    return (2 * along.abs() < length) & (2 * across.abs() < width) & there[..., None, None]


def agent_loss(states: Tensor, logits: Tensor, boxes: Tensor, count: Tensor) -> Tensor:
    """Binary cross-entropy of who is there, L1 of where; each box is matched to one query.

    states: [B, Q, 5] x, y, heading, length, width; logits: [B, Q]
    boxes: [B, Q, 5], the first count [B] of which are there
    """
    scene, query, box = match(states, logits, boxes, count)
    there = torch.zeros_like(logits)
    there[scene, query] = 1.0
    told = F.binary_cross_entropy_with_logits(logits, there)
    apart = _apart(states[scene, query], boxes[scene, box]).mean(-1)
    return told + apart.sum() / max(len(apart), 1)


@torch.no_grad()
def match(states: Tensor, logits: Tensor, boxes: Tensor, count: Tensor) -> tuple[Tensor, ...]:
    """Match queries to boxes at the least total cost (the Hungarian method).

    The costs of all scenes leave the device at once: each time it is waited for.

    states: [B, Q, 5]; logits: [B, Q]; boxes: [B, M, 5], the first count [B] of which are there;
    returns indices of scene, query and box, one a match
    """
    costs = _apart(states[:, :, None], boxes[:, None]).mean(-1) + F.softplus(-logits)[..., None]
    counts = count.tolist()
    found = [
        linear_sum_assignment(cost[:, :number])
        for cost, number in zip(costs.float().cpu().numpy(), counts, strict=True)
    ]
    scene = np.repeat(np.arange(len(found)), [len(query) for query, _ in found])
    query, box = (np.concatenate(each) for each in zip(*found, strict=True))
    return tuple(torch.from_numpy(each).to(states.device) for each in (scene, query, box))


def _apart(states: Tensor, boxes: Tensor) -> Tensor:
    """Absolute differences, headings the short way round."""
    apart = states - boxes
    turn = apart[..., HEADING]
    turn = torch.atan2(turn.sin(), turn.cos())
    return torch.cat([apart[..., :HEADING], turn[..., None], apart[..., HEADING + 1 :]], -1).abs()
