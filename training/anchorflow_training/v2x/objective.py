"""V2X-VLM's loss: L1(waypoints) + λ1 InfoNCE + λ2 distillation + λ3 location + λ4 next token."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anchorflow_models.v2x_vlm import V2XVLM
from anchorflow_models.v2x_vlm.florence import END
from anchorflow_models.v2x_vlm.losses import (
    alignment,
    distribution_distillation,
    location,
    next_token,
    regression,
    regression_distillation,
)
from anchorflow_models.v2x_vlm.network import Fused
from anchorflow_training.v2x.config import V2XRunConfig


class V2XObjective(nn.Module):
    """teacher: a trained network, which learns nothing here; None: there is none"""

    def __init__(self, model: V2XVLM, config: V2XRunConfig, teacher: V2XVLM | None) -> None:
        super().__init__()
        self.model, self.config = model, config
        # A list, so that the teacher's weights are nobody's parameters.
        self._teacher = [] if teacher is None else [teacher.eval().requires_grad_(False)]
        if config.freeze_vision:
            model.florence.model.vision_tower.requires_grad_(False)

    def draw(self, scenes: int, _samples: int, generator: torch.Generator) -> tuple[Tensor, ...]:
        """[B], whose roadside picture is withheld."""
        return (torch.rand(scenes, generator=generator) < self.config.roadside_dropout,)

    def forward(self, batch: dict[str, Tensor], withheld: Tensor) -> tuple[Tensor, dict]:
        """The loss and its terms."""
        weights = self.config.loss
        seen = _seen(self.model, batch)
        fused = self.model.fuse(*seen, ~withheld, batch["tokens"], batch["mask"])
        waypoints = self.model.drive(fused)
        terms = {"regression": regression(waypoints, batch["waypoints"])}
        total = terms["regression"]
        if weights.alignment and self.config.text:  # pairs of pictures with one text are no pairs
            terms["alignment"] = alignment(*self.model.align(fused), kappa=weights.kappa)
            total = total + weights.alignment * terms["alignment"]
        if self._teacher and weights.distillation:
            terms["distillation"] = self._distillation(waypoints, batch)
            total = total + weights.distillation * terms["distillation"]
        if weights.location:
            near, place = self.model.locate(*seen, ~withheld)
            terms["location"] = location(near, place, batch["nearest"])
            total = total + weights.location * terms["location"]
        if weights.next_token:
            terms["next_token"] = self._next_token(fused, batch)
            total = total + weights.next_token * terms["next_token"]
        return total, terms

    def _distillation(self, waypoints: Tensor, batch: dict[str, Tensor]) -> Tensor:
        """The teacher sees both pictures whatever the student sees."""
        (teacher,) = self._teacher
        with torch.no_grad():
            everything = torch.ones(len(waypoints), dtype=torch.bool, device=waypoints.device)
            wanted = teacher.drive(_fused(teacher.to(waypoints.device), batch, everything))
        if self.config.loss.distil == "regression":
            return regression_distillation(waypoints, wanted)
        return distribution_distillation(
            waypoints, wanted, temperature=self.config.loss.temperature
        )

    def _next_token(self, fused: Fused, batch: dict[str, Tensor]) -> Tensor:
        tokens, mask = batch["tokens"], batch["mask"]
        before = nn.functional.pad(tokens[:, :-1], (1, 0), value=END)
        return next_token(self.model.describe(fused, before), tokens, mask)


def _fused(model: V2XVLM, batch: dict[str, Tensor], there: Tensor) -> Fused:
    return model.fuse(*_seen(model, batch), there, batch["tokens"], batch["mask"])


def _seen(model: V2XVLM, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Both pictures' features, of one pass of the tower."""
    both = model.look(torch.cat([batch["vehicle_image"], batch["infrastructure_image"]]))
    vehicle, infrastructure = both.chunk(2)
    return vehicle, infrastructure
