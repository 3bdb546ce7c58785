"""What fixes V2X-VLM's network: a size of Florence-2, and what it is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

STRIDE = 32
"""Pixels along a side of one cell of the vision tower's last stage."""


@dataclass(frozen=True)
class FlorenceSize:
    """A vision tower (DaViT) and a language model (BART); a stage a number.

    embed_dim, num_heads, num_groups, depths: of the tower's four stages
    window: cells along a side that attend to each other
    width, layers, heads: of the language model, its encoder and its decoder alike but for
        `decoder_layers`
    """

    embed_dim: tuple[int, ...]
    num_heads: tuple[int, ...]
    depths: tuple[int, ...]
    window: int
    drop_path: float
    width: int
    layers: int
    decoder_layers: int
    heads: int
    dropout: float


SIZES: Mapping[str, FlorenceSize] = {
    "tiny": FlorenceSize(
        (32, 64, 96, 128), (1, 2, 3, 4), (1, 1, 2, 1), 6, 0.0, 128, 4, 1, 4, dropout=0.0
    ),
    "base": FlorenceSize(
        (128, 256, 512, 1024), (4, 8, 16, 32), (1, 1, 9, 1), 12, 0.1, 768, 6, 6, 12, dropout=0.1
    ),
    "large": FlorenceSize(
        (256, 512, 1024, 2048),
        (8, 16, 32, 64),
        (1, 1, 9, 1),
        12,
        0.1,
        1024,
        12,
        12,
        16,
        dropout=0.1,
    ),
}


@dataclass(frozen=True)
class V2XConfig:
    """All that fixes the network's shape.

    variant: of Florence-2; "base" and "large" are the published ones
    image_size: pixels along a side of each of the two pictures; published 768
    vocabulary: tokens that the tokenizer knows
    max_tokens: of a prompt
    positions: that the language model can tell apart: two pictures' cells, one and the prompt
    waypoints, dt: of the answer, dt [s] apart, the first at dt
    head: width of the trajectory head; dropout: in it
    projection: width of the space in which pictures and prompts are aligned

    Raises:
        ValueError: the pictures do not fall into whole cells, or there are too few positions.
    """

    variant: Literal["tiny", "base", "large"] = "tiny"
    image_size: int = 192
    vocabulary: int = 512
    max_tokens: int = 128
    positions: int = 1024
    waypoints: int = 45
    dt: float = 0.1
    head: int = 256
    dropout: float = 0.1
    projection: int = 128

    def __post_init__(self) -> None:
        if self.image_size % STRIDE or not 1 <= self.image_size // STRIDE <= 25:
            raise ValueError(
                f"image_size: expected a multiple of {STRIDE} from {STRIDE} to {25 * STRIDE}, "
                f"got {self.image_size}"
            )
        needed = 2 * self.cells**2 + 1 + self.max_tokens
        if self.positions < needed:
            raise ValueError(
                f"positions: expected at least {needed}, for two pictures of {self.image_size} "
                f"pixels and {self.max_tokens} tokens, got {self.positions}"
            )

    @property
    def cells(self) -> int:
        """Along a side of one picture's features."""
        return self.image_size // STRIDE

    @property
    def size(self) -> FlorenceSize:
        return SIZES[self.variant]
