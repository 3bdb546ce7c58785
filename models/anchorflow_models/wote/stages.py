"""Data that WoTE passes from stage to stage, and its first anchors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from anchorflow_models.transfuser import Perceived

FASTEST = 15.0  # m/s
SHARPEST = 0.5 * math.pi  # rad in all
GOLDEN = (math.sqrt(5) - 1) / 2


def arcs(count: int, *, steps: int, dt: float) -> Tensor:
    """[count, steps, 3] poses on arcs at constant speed, spread evenly over speed and turn."""
    k = torch.arange(count)
    speed = FASTEST * (k + 0.5) / count
    turn = SHARPEST * (2 * (GOLDEN * k % 1) - 1)
    times = dt * torch.arange(1, steps + 1)
    way, heading = speed[:, None] * times, turn[:, None] * times / times[-1]
    # The chord of an arc along x is sinc(heading / 2) of the way, at half the heading.
    chord = way * torch.sinc(heading / (2 * math.pi))
    return torch.stack([chord * (heading / 2).cos(), chord * (heading / 2).sin(), heading], -1)


def cells(places: Tensor, *, size: int, reach: float, ahead: float = 0.0) -> Tensor:
    """Return the cell of a BEV that contains a place: [..., 2] m -> one-hot [..., size²].

    The grid covers ±reach about a place that lies `ahead` of the ego; row 0 lies farthest ahead,
    column 0 farthest left. A place beyond the edge counts to the cell at the edge.
    """
    middle = torch.tensor([ahead, 0.0]).to(places)
    index = ((reach + middle - places) / (2 * reach) * size).floor().clamp(0, size - 1).long()
    return F.one_hot(index[..., 0] * size + index[..., 1], size * size).to(places.dtype)


@dataclass(frozen=True, eq=False)
class Seen(Perceived):
    """Everything that the sensors show.

    bev: [B, M, W] tokens; ego: [B, W]
    fine: [B, h, h, C] values that footprints look up, if there are any
    motion: [B, 4] the ego's velocity and acceleration, with `driven`
    foretold: [B, L, H', H] the share of each cell that others take at `foretold_times`, with
        encounters
    """

    bev: Tensor
    ego: Tensor
    fine: Tensor | None
    motion: Tensor | None
    foretold: Tensor | None


@dataclass(frozen=True, eq=False)
class Moved:
    """Anchors, each with the ego that would drive it.

    index: [B, K'] of the anchors; ego: [B, K', W]; offsets: [B, K', T, 3]; logits: [B, K']
    """

    index: Tensor
    ego: Tensor
    offsets: Tensor
    logits: Tensor

    def taken(self, chosen: Tensor) -> Moved:
        """Those at [B, K''] of the K'."""
        egos = chosen[..., None].expand(-1, -1, self.ego.shape[-1])
        poses = chosen[..., None, None].expand(-1, -1, *self.offsets.shape[-2:])
        return Moved(
            self.index.gather(1, chosen),
            self.ego.gather(1, egos),
            self.offsets.gather(1, poses),
            self.logits.gather(1, chosen),
        )


@dataclass(frozen=True, eq=False)
class Judged:
    """What follows from each anchor.

    future: [B, K', M, W] the BEV that is imagined
    imitation: [B, K'] logits; simulation: [B, K', 5] logits of NC, DAC, EP, TTC, C
    """

    future: Tensor
    imitation: Tensor
    simulation: Tensor
