"""Pictures and a prompt to waypoints.

    look     pixels [B,3,S,S]                     -> features [B,C,h,h], once a picture
    fuse     two pictures' features, tokens       -> hidden states [B,P,E]
    drive    hidden states                        -> waypoints [B,T,2], m, ahead and to the left
    locate   two pictures' features               -> where the nearest other is; in training alone

The two pictures lie side by side, [I_v, I_i], as one feature map of h rows and 2h columns, of
which `pooled_columns` are averaged into one, before positions are given to its cells. The tower
encodes each by itself, so the roadside picture's features can be kept; a learned cell fills its
half if it is missing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.blocks import PIXEL_MEAN, PIXEL_SPREAD
from anchorflow_models.v2x_vlm.config import V2XConfig, new_florence

LOCATED = 8
"""Channels of each cell that are left to where the nearest other is."""
STANDING = 0.05
"""m between two waypoints, at or below which a vehicle keeps its heading."""


class Fused(NamedTuple):
    """hidden: [B,P,E] of pictures and prompt; mask: [B,P], true where there is something

    image, text: [B,E], means of the inputs before fusion
    """

    hidden: Tensor
    mask: Tensor
    image: Tensor
    text: Tensor


class V2XVLM(nn.Module):
    """Florence-2 and a trajectory head.

    mean, scale: [T,2] m, of the waypoints that it was trained on: the head's unit
    tokenizer: the JSON of the tokenizer that its tokens are of; it travels with the weights
    """

    mean: Tensor
    scale: Tensor
    pixel_mean: Tensor
    pixel_std: Tensor

    def __init__(self, config: V2XConfig) -> None:
        super().__init__()
        self.config, self.tokenizer = config, b""
        size = config.size
        self.florence = new_florence(config)
        self.absent = nn.Parameter(torch.zeros(size.embed_dim[-1]))
        self.head = nn.Sequential(
            nn.Linear(size.width, config.head),
            nn.GELU(),
            nn.Dropout(config.dropout),
            nn.Linear(config.head, 2 * config.waypoints),
        )
        self.image_projection = nn.Linear(size.width, config.projection)
        self.text_projection = nn.Linear(size.width, config.projection)
        self.locator = nn.Sequential(
            nn.Conv2d(size.embed_dim[-1], LOCATED, 1),
            nn.Flatten(),
            nn.Linear(2 * LOCATED * config.cells**2, config.head),
            nn.GELU(),
            nn.Linear(config.head, 3),
        )
        self.register_buffer("mean", torch.zeros(config.waypoints, 2))
        self.register_buffer("scale", torch.ones(config.waypoints, 2))
        colour = (1, 3, 1, 1)
        self.register_buffer(
            "pixel_mean", 255 * torch.tensor(PIXEL_MEAN).view(colour), persistent=False
        )
        self.register_buffer(
            "pixel_std", 255 * torch.tensor(PIXEL_SPREAD).view(colour), persistent=False
        )

    def look(self, pixels: Tensor) -> Tensor:
        """pixels: uint8 [B,3,S,S] RGB -> features [B,C,h,h]"""
        scaled = (pixels.float() - self.pixel_mean) / self.pixel_std
        return self.florence.model.vision_tower(scaled).last_hidden_state

    def fuse(
        self,
        vehicle: Tensor,
        infrastructure: Tensor,
        has_infrastructure: Tensor,
        tokens: Tensor,
        mask: Tensor | None = None,
    ) -> Fused:
        """Pictures' features and a prompt to hidden states.

        vehicle, infrastructure: [B,C,h,h]; has_infrastructure: bool [B]
        tokens: int64 [B,L]; mask: bool [B,L], true where there is a token; None: everywhere
        """
        model = self.florence.model
        beside = self._beside(vehicle, infrastructure, has_infrastructure)
        if self.config.pooled_columns > 1:
            beside = F.avg_pool2d(beside, (1, self.config.pooled_columns))
        cells = model.multi_modal_projector(beside)
        words = model.language_model.encoder.embed_tokens(tokens)
        both = torch.cat([cells, words], 1)
        of_tokens = torch.ones_like(tokens, dtype=torch.bool) if mask is None else mask
        of_both = torch.cat([of_tokens.new_ones(cells.shape[:2]), of_tokens], 1)
        seen = None if mask is None else of_both.long()
        hidden = model.language_model.encoder(inputs_embeds=both, attention_mask=seen)
        return Fused(
            hidden.last_hidden_state, of_both, cells.mean(1), masked_mean(words, of_tokens)
        )

    def locate(
        self, vehicle: Tensor, infrastructure: Tensor, has_infrastructure: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Whether another is near, logits [B], and where the nearest is [B,2], tens of metres.

        vehicle, infrastructure: [B,C,h,h]; has_infrastructure: bool [B]
        """
        told = self.locator(self._beside(vehicle, infrastructure, has_infrastructure))
        return told[:, 0], told[:, 1:]

    def _beside(
        self, vehicle: Tensor, infrastructure: Tensor, has_infrastructure: Tensor
    ) -> Tensor:
        """[B,C,h,2h], with the learned cell in place of what there is not."""
        there = has_infrastructure[:, None, None, None]
        second = torch.where(there, infrastructure, self.absent[None, :, None, None])
        return torch.cat([vehicle, second], -1)

    def drive(self, fused: Fused) -> Tensor:
        """Waypoints [B,T,2], m."""
        out = self.head(masked_mean(fused.hidden, fused.mask))
        return self.mean + self.scale * out.unflatten(-1, (self.config.waypoints, 2))

    def align(self, fused: Fused) -> tuple[Tensor, Tensor]:
        """Pictures and prompts [B,P] on the unit sphere of one space."""
        image = nn.functional.normalize(self.image_projection(fused.image), dim=-1)
        return image, nn.functional.normalize(self.text_projection(fused.text), dim=-1)

    def describe(self, fused: Fused, words: Tensor) -> Tensor:
        """Logits [B,L,V] of the token after each of `words` [B,L], beginning with END."""
        decoded = self.florence.model.language_model.decoder(
            input_ids=words,
            encoder_hidden_states=fused.hidden,
            encoder_attention_mask=fused.mask.long(),
            use_cache=False,
        )
        return self.florence.lm_head(decoded.last_hidden_state)

    def get_extra_state(self) -> Tensor:
        """The tokenizer's bytes, among the weights."""
        return torch.from_numpy(np.frombuffer(self.tokenizer, np.uint8).copy())

    def set_extra_state(self, state: Tensor) -> None:
        self.tokenizer = state.cpu().numpy().tobytes()


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """[B,E]: the mean of values [B,P,E] where the mask [B,P] is true."""
    weights = mask.to(values.dtype)[..., None]
    return (values * weights).sum(1) / weights.sum(1)


def poses(waypoints: Tensor) -> Tensor:
    """[B,T,3] x, y, heading: waypoints [B,T,2], each headed as from the one before it.

    The first is headed from the origin; a standing vehicle keeps its heading.
    """
    before = nn.functional.pad(waypoints[:, :-1], (0, 0, 1, 0))
    step = waypoints - before
    T = step.shape[1]
    numbers = torch.arange(1, T + 1)
    moved = torch.where(step.norm(dim=-1) > STANDING, numbers, 0)
    earlier = torch.ones(T, T, dtype=torch.bool).tril()
    last = torch.where(earlier, moved[:, None, :], 0).amax(-1)
    course = nn.functional.pad(torch.atan2(step[..., 1], step[..., 0]), (1, 0))
    return torch.cat([waypoints, course.gather(1, last)[..., None]], -1)


def create_v2x_vlm(config: V2XConfig) -> V2XVLM:
    """A network of the configuration, its weights drawn at random."""
    return V2XVLM(config)


METRES = 10.0
"""Unit of predicted places."""


def regression(waypoints: Tensor, driven: Tensor) -> Tensor:
    """Smooth L1 of waypoints [B,T,2], m."""
    return F.smooth_l1_loss(waypoints, driven)


def alignment(image: Tensor, text: Tensor, *, kappa: float) -> Tensor:
    """InfoNCE in both directions between unit vectors [B,P], of which pairs share a row.

    -1/2B Σ_i [log softmax_j(z_i·h_j / κ)_i + log softmax_j(z_j·h_i / κ)_i]
    """
    likeness = image @ text.T / kappa
    pairs = torch.arange(len(likeness), device=likeness.device)
    return (F.cross_entropy(likeness, pairs) + F.cross_entropy(likeness.T, pairs)) / 2


def distribution_distillation(student: Tensor, teacher: Tensor, *, temperature: float) -> Tensor:
    """τ² KL(softmax(teacher/τ) ‖ softmax(student/τ)) over the 2T coordinates of [B,T,2], of
    temperature τ.

    As it was published. A softmax over coordinates gives nearly all the weight to the waypoints
    that lie farthest ahead, and moving all of them alike changes nothing.
    """
    wanted = F.log_softmax(teacher.flatten(1) / temperature, -1)
    got = F.log_softmax(student.flatten(1) / temperature, -1)
    divergence = F.kl_div(got, wanted, reduction="batchmean", log_target=True)
    return temperature**2 * divergence


def regression_distillation(student: Tensor, teacher: Tensor) -> Tensor:
    """Smooth L1 from the teacher's waypoints [B,T,2], m."""
    return F.smooth_l1_loss(student, teacher)


def next_token(logits: Tensor, wanted: Tensor, mask: Tensor) -> Tensor:
    """Cross-entropy of logits [B,L,V] where the mask [B,L] is true."""
    return F.cross_entropy(logits[mask], wanted[mask])


def location(near: Tensor, place: Tensor, nearest: Tensor) -> Tensor:
    """Return the loss of locating the nearest other [B,3]: 1 if there is one, and x, y in m.

    near: logits [B]; place: [B,2], tens of metres
    """
    there = nearest[:, 0]
    apart = (place - nearest[:, 1:] / METRES).abs().mean(-1)
    return F.binary_cross_entropy_with_logits(near, there) + (there * apart).mean()
