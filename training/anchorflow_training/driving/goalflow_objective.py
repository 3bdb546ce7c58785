"""The losses of GoalFlow: goals and flow, or the outcomes of what it proposes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_driving.pdm import SUB_SCORES
from anchorflow_models.flow_matching import interpolate
from anchorflow_models.goalflow import GoalFlow, SensorGoalFlow
from anchorflow_models.goalflow.config import SENSED_STRIDE, STRIDE
from anchorflow_models.goalflow.goalflow import POSE
from anchorflow_models.goalflow.networks import at_places
from anchorflow_models.goalflow.trajectory_score import FRONT, LEARNT, REAR, body_places
from anchorflow_training.driving.sensor_windows import sensors_of
from anchorflow_training.settings import setting

CLEAR = 0.5  # share of a cell that is drivable where its middle is


@dataclass(frozen=True)
class GoalFlowObjectiveConfig:
    """The stage; the losses of the first, their weights, and what they aim at."""

    stage: Literal["flow", "outcomes"] = setting(
        "flow", "What is learnt: goals and the flow; then what becomes of trajectories."
    )
    forgotten: float = setting(
        0.2, "Share of what outcomes are learnt from that a step leaves out.", ge=0, lt=1
    )
    goal_weight: float = setting(1.0, "Of the goals' scores.", ge=0)
    flow_weight: float = setting(10.0, "Of the flow.", ge=0)
    surface_weight: float = setting(
        1.0, "Of the road and the others that sensors show, by the raster.", ge=0
    )
    flow_time: Literal["uniform", "middle"] = setting(
        "uniform", "How flow times are drawn; middle: sigmoid of a Gaussian."
    )
    scored: int = setting(64, "Goals a window that are scored in a step.", ge=8)
    near: float = setting(2.0, "m, spread of what counts as near the recorded end.", gt=0)
    aside: float = setting(1.2, "m, spread of what counts as on the route.", gt=0)
    jitter: float = setting(0.8, "m, spread of a goal around the end that it is for.", ge=0)
    shadows: int = setting(1, "Targets a window that are learnt without a goal.", ge=0)
    least_left: float = setting(
        0.3, "Of flow time, that an error counts by; less would be noise.", gt=0, le=1
    )


class GoalFlowObjective(nn.Module):
    """Loss and its terms on a batch of `DrawnWindows`."""

    places: Tensor

    def __init__(self, model: GoalFlow, config: GoalFlowObjectiveConfig) -> None:
        super().__init__()
        self.model, self.config = model, config
        layout = model.config.bev
        low_x, high_x, low_y, high_y = layout.extent
        x = high_x - (high_x - low_x) * (torch.arange(layout.rows) + 0.5) / layout.rows
        y = high_y - (high_y - low_y) * (torch.arange(layout.columns) + 0.5) / layout.columns
        grid = torch.stack(torch.meshgrid(x, y, indexing="ij"), -1)
        self.register_buffer("places", grid, persistent=False)

    def draw(self, scenes: int, samples: int, generator: torch.Generator) -> tuple[Tensor, ...]:
        """Noise [B, N, 3T], flow times [B, N], jitter [B, N, 2], order of goals [B, K]."""
        shape, config = (scenes, samples), self.model.config
        noise = torch.randn(*shape, POSE * config.num_steps, generator=generator)
        if self.config.flow_time == "middle":
            times = torch.randn(shape, generator=generator).sigmoid()
        else:
            times = torch.rand(shape, generator=generator)
        jitter = self.config.jitter * torch.randn(*shape, 2, generator=generator)
        return noise, times, jitter, torch.rand(scenes, config.goals, generator=generator)

    def forward(
        self, batch: Mapping[str, Tensor], noise: Tensor, t: Tensor, jitter: Tensor, chance: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        targets = batch["targets"]
        context, seen = self._look(batch)
        flow, expected = self._flow(batch, context, noise, t, jitter)
        goals = self._goals(batch, context, chance, expected.detach())
        terms = {"flow": flow, **goals}
        loss = (
            self.config.flow_weight * flow
            + self.config.goal_weight * torch.stack([*goals.values()]).sum()
            + self.config.surface_weight * sum(seen.values())
        )
        with torch.no_grad():
            miss = (expected - targets)[..., :2].square().sum(-1).sqrt()
        return loss, {**terms, **seen, "displacement_m": miss.mean()}

    def _look(self, batch: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """Return the context, with the road of the raster, and what is learnt of surfaces."""
        model, size = self.model, batch["size"]
        bev = self.moved(batch["bev"], batch["moved"])
        if not isinstance(model, SensorGoalFlow):
            return model.look(bev, batch["status"], size), {}
        context = model.look(**sensors_of(batch), vehicle_size=size)
        drivable, occupied = model.surfaces(model.cells(bev))
        drawn = torch.cat([drivable.permute(0, 3, 1, 2), occupied], 1)
        shares = F.avg_pool2d(drawn, STRIDE // SENSED_STRIDE)
        told = F.binary_cross_entropy_with_logits(
            context["surface_logits"], shares, reduction="none"
        ).mean((0, 2, 3))
        terms = {"road": told[0], "others": told[1:].mean()}
        return context | {"drivable": drivable}, terms

    def moved(self, bev: Tensor, moved: Tensor) -> Tensor:
        """Rasters [B, C, H, W] seen from starts [B, 3] (x, y, heading) in the frame of each."""
        which = moved.abs().sum(1) > 0
        if not which.any():
            return bev
        bev, own = bev.float(), moved[which][:, None, None]
        cos, sin = own[..., 2].cos(), own[..., 2].sin()
        x, y = self.places.unbind(-1)
        x, y = own[..., 0] + cos * x - sin * y, own[..., 1] + sin * x + cos * y
        low_x, high_x, low_y, high_y = self.model.config.bev.extent
        grid = torch.stack(
            [1 - 2 * (y - low_y) / (high_y - low_y), 1 - 2 * (x - low_x) / (high_x - low_x)], -1
        )
        bev[which] = F.grid_sample(bev[which], grid, align_corners=False)
        return bev

    def begun(
        self, targets: Tensor, status: Tensor, context: Mapping[str, Tensor], jitter: Tensor
    ) -> Tensor:
        """The ways [B, N, T, S] that targets [B, N, T, 3] begin on; the first have no goal."""
        ways = self.model.ways_to(targets[..., -1, :2] + jitter, context["speed"])
        shadows = min(self.config.shadows, targets.shape[1])
        shadow = self.model.shadow(status, context["speed"]).expand(-1, shadows, -1, -1)
        return torch.cat([shadow, ways[:, shadows:]], 1)

    def _flow(
        self,
        batch: Mapping[str, Tensor],
        context: dict[str, Tensor],
        noise: Tensor,
        t: Tensor,
        jitter: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """The loss, and the poses [B, N, T, 3] that are expected of x_t."""
        model, targets = self.model, batch["targets"]
        mean = self.begun(targets, batch["status"], context, jitter)
        x_1 = torch.cat([targets, mean[..., POSE:]], -1)
        x_t, _ = interpolate(model.draw(noise, mean), x_1, t)
        modulation = model.modulate(t, context)[..., 1:]
        expected = model.expected(x_t, mean, modulation, context)
        # u - u* = (expected - x_1) / (1 - t)
        error = (expected - targets) / model.stray
        left = (1 - t).clamp(min=self.config.least_left)[..., None, None]
        return (error / left).clamp(-10, 10).square().mean(), expected

    def _goals(
        self,
        batch: Mapping[str, Tensor],
        context: dict[str, Tensor],
        chance: Tensor,
        expected: Tensor,
    ) -> dict[str, Tensor]:
        model, config = self.model, self.config
        end = batch["goal"][:, None] if "goal" in batch else batch["targets"][:, :1, -1, :2]
        away = (model.vocabulary - end).square().sum(-1)
        # A quarter of them near the end, where scores change; the others anywhere.
        near = config.scored // 4
        first = away.argsort(-1)[:, :near]
        order = chance.scatter(1, first, 2.0).argsort(-1, descending=True)[:, : config.scored]
        ways = model.ways_to(model.vocabulary[order], context["speed"])[..., :POSE]
        ways = torch.cat([ways, expected], 1)
        with torch.no_grad():
            distance = (ways[..., -1, :2] - end).square().sum(-1)
            is_near = torch.exp(-0.5 * distance / config.near**2)
            is_drivable = self._drivable(ways, batch["size"], context)
            strayed = _from_line(ways[..., :2], batch["course"]).amax(-1)
            on_route = torch.exp(-0.5 * (strayed / config.aside).square())
        scores = model.rate(ways, context)
        wanted = {"distance": is_near, "drivable": is_drivable, "route": on_route}
        return {
            name: F.binary_cross_entropy_with_logits(getattr(scores, name), target)
            for name, target in wanted.items()
        }

    def _drivable(self, ways: Tensor, size: Tensor, context: Mapping[str, Tensor]) -> Tensor:
        """Return [B, P]: 1 if all corners of the ego are on the road at the end of a way."""
        ends = ways[..., -1:, :]
        corners = body_places(ends, size, rows=(FRONT, REAR), files=(-1.0, 1.0))
        share = at_places(context["drivable"], corners, self.model.config.bev.covered)
        return (share.flatten(2).amin(-1) > CLEAR).float()


def _from_line(points: Tensor, line: Tensor) -> Tensor:
    """Distances [B, P, T] of points [B, P, T, 2] from lines [B, V, 2], by their vertices' spans."""
    begin, along = line[:, :-1], line.diff(dim=1)
    flat = points.flatten(1, 2)
    offset = flat[:, :, None] - begin[:, None]
    length = along.square().sum(-1).clamp(min=1e-6)
    share = ((offset * along[:, None]).sum(-1) / length[:, None]).clamp(0.0, 1.0)
    miss = offset - share[..., None] * along[:, None]
    return miss.square().sum(-1).amin(-1).sqrt().unflatten(1, points.shape[1:3])


class OutcomeObjective(nn.Module):
    """Loss and its terms on windows with `Proposals`: binary cross entropies of sub-scores.

    forgotten: share of the scorer's inputs that each step drops
    """

    def __init__(self, model: GoalFlow, *, forgotten: float) -> None:
        super().__init__()
        self.model, self.forgotten = model, forgotten
        self.order = [SUB_SCORES.index(name) for name in LEARNT]

    def draw(self, scenes: int, samples: int, generator: torch.Generator) -> tuple[Tensor, ...]:  # noqa: ARG002
        """Nothing: what is forgotten hangs on the step's seed."""
        return ()

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        model, poses = self.model, batch["trajectories"]
        assert model.outcomes is not None
        with torch.no_grad():
            context = model.look(batch["bev"], batch["status"], batch["size"])
            told = model.told(model.judged(poses, context), context)
        kept = torch.rand(told.shape[-1], device=told.device) >= self.forgotten
        logits = model.outcomes(told * kept / (1 - self.forgotten), context["context"])
        losses = F.binary_cross_entropy_with_logits(
            logits, batch["scores"][..., self.order], reduction="none"
        ).mean((0, 1))
        return losses.sum(), dict(zip(LEARNT, losses, strict=True))
