"""What WoTE passes from stage to stage: what is seen, anchors moved, what follows from each."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from anchorflow_models.transfuser import Moving


@dataclass(frozen=True, eq=False)
class Seen:
    """What the sensors tell.

    bev: [B, M, W] tokens; ego: [B, W]
    agents: [B, Q, 5] x, y, heading, length, width; agent_logits: [B, Q]
    semantic_logits: [B, classes, H/2, H] of the half before the ego
    occupancy_logits: [B, T, H/4, H/4] of where others will be when the poses are reached
    upscaled: [B, C', H/4, H/4] the backbone's BEV
    fine: [B, h, h, C] what footprints look up, where there are any
    motion: [B, 4] the ego's velocity and acceleration, where it is asked what is driven
    foretold: [B, L, H', H] the share of each cell that others take at `foretold_times`, with
        encounters; moving: where they are and how fast they move; far: beyond the LiDAR
    """

    bev: Tensor
    ego: Tensor
    agents: Tensor
    agent_logits: Tensor
    semantic_logits: Tensor
    occupancy_logits: Tensor
    upscaled: Tensor
    fine: Tensor | None
    motion: Tensor | None
    foretold: Tensor | None
    moving: Moving | None
    far: Moving | None


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
