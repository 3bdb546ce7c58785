"""The latent world model: the BEV after an anchor, and what that is worth."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.layers.attention import EncoderLayer
from anchorflow_models.layers.blocks import scalar_head
from anchorflow_models.sub_scores import SUB_SCORES
from anchorflow_models.wote.config import RewardWeights


class WorldModel(nn.Module):
    """The ego's token and the BEV's attend to each other, `steps` times with the same layers.

    places: [1, 1 + M, W], learned, of the ego and of the BEV's M cells; [1, 1, W] if the cells have
        those of the present BEV, `keys`
    """

    def __init__(
        self, width: int, heads: int, *, hidden: int, layers: int, cells: int, steps: int
    ) -> None:
        super().__init__()
        self.steps = steps
        self.places = nn.Parameter(0.02 * torch.randn(1, 1 + cells, width))
        self.layers = nn.Sequential(
            *[EncoderLayer(width, heads, hidden=hidden) for _ in range(layers)]
        )

    def forward(
        self,
        ego: Tensor,
        bev: Tensor,
        *,
        here: Tensor,
        there: Tensor,
        keys: Tensor | None = None,
    ) -> tuple[Tensor, list[Tensor]]:
        """Ego and BEV in the future of every anchor.

        ego: [B, K, W]; bev: [B, M, W]
        here: [M] one-hot, the ego's cell now; there: [B or 1, K, steps, M], its cells to come
        keys: [1, M, W], places of cells that are not the world model's own
        Returns ego [B, K, W] and the BEV [B, K, M, W] after each step, the ego added where it will
        be.
        """
        batch, count, width = ego.shape
        places = self.places if keys is None else torch.cat([self.places, keys], 1)
        futures = []
        bev = inject(bev[:, None], here, ego)
        for step in range(self.steps):
            # Without layers the present BEV is kept.
            if len(self.layers):
                tokens = torch.cat([ego[:, :, None], bev], 2)
                tokens = tokens.reshape(batch * count, -1, width) + places
                tokens = self.layers(tokens).reshape(batch, count, -1, width)
                ego, bev = tokens[:, :, 0], tokens[:, :, 1:]
            bev = inject(bev, there[:, :, step], ego)
            futures.append(bev)
        return ego, futures


def inject(bev: Tensor, cell: Tensor, ego: Tensor) -> Tensor:
    """The BEV [B, 1 or K, M, W] with the ego [B, K, W] added in its cell, one-hot [..., M].

    A product with zeros and a one rather than a scatter: it exports, and no index of one scene can
    reach another.
    """
    return bev + cell[..., None] * ego[:, :, None]


_NC, _DAC, _EP, _TTC, _C = range(len(SUB_SCORES))
TINY = 1e-6


class RewardHead(nn.Module):
    """The present BEV, one of the future or several, and the ego in the last, to rewards.

    The first convolution is one of all BEVs, one upon the other, taken apart: its share of the
    present is the same for all anchors.
    """

    def __init__(self, width: int, size: int, *, futures: int = 1) -> None:
        super().__init__()
        self.size, self.width = size, width
        self.present = nn.Conv2d(width, width, 3, padding=1)
        self.future = nn.Conv2d(futures * width, width, 3, padding=1, bias=False)
        self.both = nn.Conv2d(width, width, 3, padding=1)
        self.with_ego = nn.Linear(2 * width, width)
        self.imitation = scalar_head(width)
        self.simulation = nn.ModuleList(scalar_head(width) for _ in SUB_SCORES)

    def forward(
        self, ego: Tensor, bev: Tensor, future: Tensor, under: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """ego: [B, K, W]; bev: [B, M, W]; future: [B, K, M, n W] of n steps; under: [B, K, W] of
        footprint and encounters.

        Returns logits of imitation [B, K] and of simulation [B, K, 5].
        """
        batch, count, cells, channels = future.shape
        images = self.future(self._image(future.reshape(batch * count, cells, channels)))
        present = self.present(self._image(bev))[:, None]
        x = F.relu(images.unflatten(0, (batch, count)) + present).flatten(0, 1)
        # ReLU and mean as one number a channel: what is anywhere counts.
        seen = F.relu(self.both(x)).mean((-2, -1)).reshape(batch, count, self.width)
        feature = self.with_ego(torch.cat([seen, ego], -1))
        feature = F.relu(feature if under is None else feature + under)
        simulated = torch.cat([head(feature) for head in self.simulation], -1)
        return self.imitation(feature).squeeze(-1), simulated

    def _image(self, tokens: Tensor) -> Tensor:
        return tokens.transpose(1, 2).unflatten(-1, (self.size, self.size))


def final_scores(imitation: Tensor, simulation: Tensor, weights: RewardWeights) -> Tensor:
    """Scores [B, K] of logits [B, K] over all anchors and [B, K, 5]; higher is better."""
    # Logarithms and softplus throughout: onnxruntime's sigmoid saturates at -18.
    log_im, log_sim = imitation.log_softmax(-1), -F.softplus(-simulation)
    shares = torch.tensor([weights.ttc, weights.c, weights.ep]).clamp(min=TINY).log()
    parts = torch.stack([log_sim[..., index] for index in (_TTC, _C, _EP)], -1)
    rest = (parts + shares.to(parts)).logsumexp(-1)
    safe = weights.nc * log_sim[..., _NC] + weights.dac * log_sim[..., _DAC]
    return weights.im * log_im + safe + weights.rest * rest
