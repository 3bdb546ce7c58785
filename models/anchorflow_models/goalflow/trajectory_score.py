"""The score of a trajectory: a soft PDM score among boxes at constant velocity.

Collisions and the road are judged on the motion of a car that tracks the trajectory (`tracking`).

    score = route^a · goal^b · drivable^d · reach · DAC · NC · (e EP + t TTC + c C) / (e + t + c)

Each term lies between 0 and 1, and no trajectory's depends on the others. The weights are
`ScoreWeights`. Learnt outcomes, if a network has them, take the place of most of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor, nn

from anchorflow_models.goalflow.config import GoalFlowConfig, ScoreWeights
from anchorflow_models.goalflow.networks import WayScores, at_places, at_times
from anchorflow_models.lqr_rollout import WHEELBASE, Driven, Start, driven, halved

FRONT, REAR = 0.7823, -0.2177
"""Of the bumpers before the rear axle, in lengths (`anchorflow_driving.window.REAR_AXLE`)."""
# A collision behind these points is not the ego's fault.
ROWS, FILES = (FRONT, 0.53, 0.28), (-1.0, 0.0, 1.0)
GAP = 0.2
"""Share of a length that is kept free ahead."""
AHEAD_S = (0.5, 0.9)
"""Seconds that the time to collision looks ahead."""
LOOKS_S = (0.0, 0.5, 1.0, -0.5)
"""Seconds ahead of its poses at which the ego's front is looked up, one for each look."""
WIDER = (2.0, 1.2)  # m more in length and width, of a second look-up
LOOKS = len(LOOKS_S) + 1
PULL = 1.5  # m/s², of a car that nothing holds up
HALF, SHARP = 0.5, 0.1  # of a cell's share: what counts as covered, and how sharply
MOVING = 0.3  # m/s; a standing ego is not at fault
# Bounds of comfort and how sharply each is kept: m/s², m/s², m/s², m/s³, rad/s.
COMFORT = {
    "pulling": (2.3, 0.1),
    "braking": (3.9, 0.2),
    "lateral": (4.4, 0.3),
    "jerk": (4.0, 0.4),
    "yaw_rate": (0.9, 0.05),
}


LEARNT = ("nc", "dac", "ep", "ttc")
"""Sub-scores that are learnt; comfort is a trajectory's own, and its rule says it."""
POSE_FEATURES = 4 + 3  # x, y, direction; speed, acceleration, yaw rate
NC_POWER = 3
"""A collision forfeits all else, and a mean over what may come takes it for half a loss; set on
simulated windows (docs/goalflow-bundle.md)."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Inputs of a score.

    drivable: [B, H, W, 1]; occupied: [B, 1 + K, H, W] now and foretold, all from 0 to 1
    speed, acceleration, curvature: [B] now, m/s, m/s² and 1/m to the left
    size: [B, 2] of the ego, m
    """

    drivable: Tensor
    occupied: Tensor
    speed: Tensor
    acceleration: Tensor
    curvature: Tensor
    size: Tensor

    @property
    def start(self) -> Start:
        """The start of a controller."""
        wheelbase = WHEELBASE * self.size[:, 0]
        return Start(self.speed, self.acceleration, self.curvature, wheelbase)


class Motion(NamedTuple):
    """[B, N, T] each: m/s, m/s² since the pose before, rad/s since then."""

    speed: Tensor
    acceleration: Tensor
    yaw_rate: Tensor


class Rules(NamedTuple):
    """[B, N] each, from 0 to 1: what can be said of a trajectory without having learnt it.

    on_road: DAC; clear: NC; ahead: TTC; comfort: C; progress: of the way that a clear road allows
    """

    on_road: Tensor
    clear: Tensor
    ahead: Tensor
    comfort: Tensor
    progress: Tensor


RULES = Rules._fields


class Judged(NamedTuple):
    """Trajectories [B, N, T, 3]: how they move, what is driven by who follows them, and what the
    rules say.
    """

    motion: Motion
    driven: Driven
    rules: Rules


def motion_of(poses: Tensor, around: Surroundings, config: GoalFlowConfig) -> Motion:
    """Return the motion along trajectories [B, N, T, 3]."""
    speed = _speeds(poses, dt=config.dt)
    now = around.speed[:, None, None].expand_as(speed[..., :1])
    heading = torch.cat([torch.zeros_like(poses[..., :1, 2]), poses[..., 2]], -1)
    return Motion(
        speed,
        torch.cat([now, speed], -1).diff(dim=-1) / config.dt,
        heading.diff(dim=-1) / config.dt,
    )


def judge(
    poses: Tensor, around: Surroundings, config: GoalFlowConfig, weights: ScoreWeights
) -> Judged:
    """Judge trajectories [B, N, T, 3] on the motion that follows them."""
    motion = motion_of(poses, around, config)
    own = driven(poses, around.start, dt=config.dt)
    rules = Rules(
        on_road=_on_road(own.poses, around, config),
        clear=_clear(*own, around, config),
        ahead=_time_to_collision(*own, around, config),
        comfort=_comfort(motion, dt=config.dt),
        progress=_progress(poses, around.speed, config, clear_speed=weights.clear_speed),
    )
    return Judged(motion, own, rules)


def met(own: Driven, around: Surroundings, config: GoalFlowConfig) -> Tensor:
    """[B, N, LOOKS · T]: how much of a cell under the ego's front is taken at each pose, for each
    of LOOKS_S; and then for an ego that is WIDER.
    """
    poses, speed = own
    layer = torch.arange(poses.shape[-2], device=poses.device) + 1
    last = around.occupied.shape[1] - 1
    looks = torch.cat([_moved(poses, speed * seconds) for seconds in LOOKS_S], -2)
    layers = [layer + round(max(seconds, 0.0) / config.dt) for seconds in LOOKS_S]
    hits = _hits(looks, torch.cat(layers).clamp(max=last), around, config)
    wide = replace(around, size=around.size + torch.tensor(WIDER, device=poses.device))
    return torch.cat([hits, _hits(poses, layer, wide, config)], -1)


def trajectory_scores(
    rules: Rules, missed: Tensor, ways: WayScores, weights: ScoreWeights
) -> Tensor:
    """Scores [B, N] of trajectories.

    missed: [B, N] m between a trajectory's end and its goal; 0 where it has none
    ways: logits of the trajectories
    weights: numbers, or tensors [B, 1]
    """
    parts = {
        "route": ways.route.sigmoid() ** weights.route,
        "goal": ways.distance.sigmoid() ** weights.goal,
        "drivable": ways.drivable.sigmoid() ** weights.drivable,
        "reach": torch.exp(-0.5 * (missed / weights.reach).square()),
        "DAC": rules.on_road,
        "NC": rules.clear,
    }
    means = (
        (weights.progress, rules.progress),
        (weights.time_to_collision, rules.ahead),
        (weights.comfort, rules.comfort),
    )
    total = sum(weight for weight, _ in means)
    worth = torch.stack([weight / total * part for weight, part in means]).sum(0)
    for part in parts.values():
        worth = worth * part
    return worth


class OutcomeScorer(nn.Module):
    """Logits [B, N, 4] of trajectories, from the features and occupancy at their poses, and the
    rules, which know others' present velocities and no turn.
    """

    def __init__(self, *, steps: int, features: int, context: int, width: int) -> None:
        super().__init__()
        told = steps * (features + POSE_FEATURES + LOOKS) + len(RULES)
        self.of_way = nn.Linear(told, width)
        self.of_scene = nn.Linear(context, width)
        self.rest = nn.Sequential(
            nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU()
        )
        self.out = nn.Linear(width, len(LEARNT))

    def forward(self, told: Tensor, context: Tensor) -> Tensor:
        """told [B, N, F], as `GoalFlow.told` has it; context [B, E]."""
        return self.out(self.rest(self.of_way(told) + self.of_scene(context)[:, None]))


def outcome_scores(logits: Tensor, rules: Rules, by_rules: Tensor) -> Tensor:
    """The PDM score [B, N] of what is expected: learnt logits [B, N, 4] and the rules agree on who
    is hit and what is road, the rule says what is comfortable, and the rest is learnt; times the
    root of the score by the rules [B, N], which believe in no traffic that was learnt.
    """
    nc, dac, ep, ttc = logits.sigmoid().unbind(-1)
    kept = rules.clear * nc**NC_POWER * rules.on_road * dac
    return kept * (5 * ep + 5 * ttc + 2 * rules.comfort) / 12 * by_rules.sqrt()


def _on_road(poses: Tensor, around: Surroundings, config: GoalFlowConfig) -> Tensor:
    """[B, N]: whether all corners stay on what may be driven on."""
    corners = body_places(halved(poses), around.size, rows=(FRONT, REAR), files=(-1.0, 1.0))
    share = at_places(around.drivable, corners, config.bev.covered)[..., 0]
    return _covered(share.flatten(2).amin(-1))


def _clear(poses: Tensor, speed: Tensor, around: Surroundings, config: GoalFlowConfig) -> Tensor:
    """Return [B, N]: whether a moving ego's front keeps the gap to every box."""
    moving = (speed / MOVING).clamp(0.0, 1.0)
    layer = torch.arange(poses.shape[-2], device=poses.device)
    middles = halved(poses)[..., ::2, :]
    # Halfway between two layers a box may still be where it was, or be where it will be.
    asked = torch.cat([poses, middles, middles], -2)
    layers = torch.cat([layer + 1, layer, layer + 1])
    hits = _hits(asked, layers, around, config, gap=GAP)
    return 1 - _covered((hits.unflatten(-1, (3, -1)).amax(-2) * moving).amax(-1))


def _time_to_collision(
    poses: Tensor, speed: Tensor, around: Surroundings, config: GoalFlowConfig
) -> Tensor:
    """Return [B, N]: whether driving straight on at the same speed hits no box for AHEAD_S."""
    count, steps = around.occupied.shape[1] - 1, poses.shape[-2]
    moving = (speed / MOVING).clamp(0.0, 1.0)
    layers = torch.arange(steps, device=poses.device) + 1
    looks = [(m, s, min(steps, count - m)) for m, s in enumerate(AHEAD_S, start=1)]
    ahead = [_moved(poses, speed * seconds)[..., :known, :] for _, seconds, known in looks]
    layer = [layers[:known] + more for more, _, known in looks]
    hits = _hits(torch.cat(ahead, -2), torch.cat(layer), around, config)
    going = torch.cat([moving[..., :known] for *_, known in looks], -1)
    return 1 - _covered((hits * going).amax(-1))


def _comfort(motion: Motion, *, dt: float) -> Tensor:
    """[B, N]: whether what passengers feel keeps its bounds."""
    speed, acceleration, yaw_rate = motion
    jerk = acceleration.diff(dim=-1) / dt
    felt = {
        "pulling": acceleration,
        "braking": -acceleration,
        "lateral": (speed * yaw_rate).abs(),
        "jerk": jerk.abs(),
        "yaw_rate": yaw_rate.abs(),
    }
    kept = torch.ones_like(speed[..., 0])
    for name, values in felt.items():
        bound, sharp = COMFORT[name]
        kept = kept * ((bound - values.amax(-1)) / sharp).sigmoid()
    return kept


def _progress(
    poses: Tensor, speed: Tensor, config: GoalFlowConfig, *, clear_speed: float
) -> Tensor:
    """[B, N]: of the way that a road allows on which `clear_speed` is driven."""
    way, speed = _steps(poses).sum(-1), speed[:, None]
    duration = poses.shape[-2] * config.dt
    pulling = ((clear_speed - speed) / PULL).clamp(0.0, duration)
    allowed = speed * duration + PULL * pulling * (duration - 0.5 * pulling)
    return (way / allowed.clamp(min=5.0)).clamp(max=1.0)


def _hits(
    poses: Tensor, layer: Tensor, around: Surroundings, config: GoalFlowConfig, *, gap: float = 0.0
) -> Tensor:
    """[B, N, P]: how much of a cell under the ego's front is taken, of poses [B, N, P, 3].

    gap: lengths by which the front is farther ahead
    """
    front, *behind = ROWS
    body = body_places(poses, around.size, rows=(front + gap, *behind), files=FILES)
    count = body.shape[-2]
    asked = layer.repeat_interleave(count)
    share = at_times(around.occupied, body.flatten(2, 3), asked, config.bev.covered)
    return share.unflatten(-1, (-1, count)).amax(-1)


def body_places(
    poses: Tensor, size: Tensor, *, rows: tuple[float, ...], files: tuple[float, ...]
) -> Tensor:
    """Places [B, N, P, R, 2] on the ego's body at poses [B, N, P, 3].

    rows: before the rear axle, in lengths; files: left of its middle, in half widths
    """
    grid = torch.tensor([[row, 0.5 * file] for row in rows for file in files], device=poses.device)
    own = (grid * size[:, None])[:, None, None]
    cos, sin = poses[..., 2].cos()[..., None], poses[..., 2].sin()[..., None]
    ahead, left = own[..., 0], own[..., 1]
    x = poses[..., 0, None] + cos * ahead - sin * left
    y = poses[..., 1, None] + sin * ahead + cos * left
    return torch.stack([x, y], -1)


def _moved(poses: Tensor, way: Tensor) -> Tensor:
    """Poses [..., 3] straight ahead by ways [...]."""
    x, y, heading = poses.unbind(-1)
    return torch.stack([x + way * heading.cos(), y + way * heading.sin(), heading], -1)


def _steps(poses: Tensor) -> Tensor:
    """[..., T] m from each pose to the next, the first from now."""
    places = poses[..., :2]
    before = torch.cat([torch.zeros_like(places[..., :1, :]), places[..., :-1, :]], -2)
    return (places - before).square().sum(-1).clamp(min=1e-8).sqrt()


def _speeds(poses: Tensor, *, dt: float) -> Tensor:
    """[..., T] m/s at the poses; that between two is the mean of theirs."""
    mean = _steps(poses) / dt
    following = torch.cat([mean[..., 1:], 2.0 * mean[..., -1:] - mean[..., -2:-1]], -1)
    return (0.5 * (mean + following)).clamp(min=0.0)


def _covered(share: Tensor) -> Tensor:
    return ((share - HALF) / SHARP).sigmoid()
