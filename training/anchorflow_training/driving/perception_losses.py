"""Losses of what a Transfuser backbone is asked besides a plan."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor
from torch.nn import functional as F

from anchorflow_models.transfuser import LIDAR_BEFORE, Moving, SweepMotion, TransfuserConfig
from anchorflow_training.driving.sensor_windows import LIDAR_RANDOMISED

HEADING = 2  # of x, y, heading, length, width
MOVES = 0.5  # m/s
MOVING = 4.0  # times what the velocity of something at rest weighs
CLOSE = 0.3  # m/s, below which smooth L1 is a square
THERE = 5.0  # times the loss of velocities weighs whether somebody is there


def focal_loss(
    logits: Tensor, classes: Tensor, *, alpha: float = 0.5, gamma: float = 2.0
) -> Tensor:
    """-α (1 - p)^γ log p of the true class [B], the mean over its cells (Lin et al., 2017).

    logits: [B, classes, H, W]; classes: integers [B, H, W]
    """
    log_p = logits.log_softmax(1).gather(1, classes.long()[:, None])[:, 0]
    return -(alpha * (1 - log_p.exp()).pow(gamma) * log_p).mean((1, 2))


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


def sweep_losses(
    sweeps: SweepMotion,
    upscaled: Tensor,
    moving: Moving,
    far: Moving,
    batch: Mapping[str, Tensor],
    backbone: TransfuserConfig,
) -> dict[str, Tensor]:
    """The terms `motion` and `far`: of others that move as they did and as chance has it, by the
    sweeps, and of those beyond, by the camera.

    upscaled, moving, far: as they were seen in the batch, which holds lidar, lidar_randomised,
        agents, agent_velocity, randomised_velocity, agent_count and far_others, far_velocity,
        far_count; where it lacks lidar_before, `moving` teaches nothing
    """
    cell, reach = backbone.upscaled_cell, backbone.lidar_range
    chance = sweeps(batch["lidar"], batch[LIDAR_RANDOMISED], upscaled)
    learnt = [(chance, batch["randomised_velocity"])]
    if LIDAR_BEFORE in batch:
        learnt.append((moving, batch["agent_velocity"]))
    boxes, count = batch["agents"], batch["agent_count"]
    losses = [
        motion_loss(each, boxes, true, count, cell=cell, ahead=reach) for each, true in learnt
    ]
    others = (batch["far_others"], batch["far_velocity"], batch["far_count"])
    beyond = motion_loss(far, *others, cell=cell, ahead=reach + backbone.far_range)
    return {"motion": torch.stack(losses).mean(), "far": beyond}


def _inside(boxes: Tensor, count: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """[B, Q, rows, columns]: whether the middle of a cell, at x [rows] and y [columns], lies in a
    box.
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
    """Which query tells of which box, at the least cost in all (the Hungarian method).

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
