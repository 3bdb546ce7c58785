"""The configuration of V2X-VLM, and the native Florence-2 classes made of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from torch import nn

from anchorflow_models.checks import check

STRIDE = 32
"""Pixels along a side of one cell of the vision tower's last stage."""
MOST_CELLS = 25
"""Along a side of one picture."""
LEAST = {
    "vocabulary": 3,  # Florence-2's own tokens
    "max_tokens": 1,
    "positions": 1,
    "waypoints": 1,
    "head": 1,
    "projection": 1,
    "pooled_columns": 1,
}


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
    positions: of the language model, for two pictures' cells, one and the prompt
    pooled_columns: cells of a row whose mean enters the language model; with 2, both pictures
        take the grid of one, which is what the published weights know
    waypoints, dt: of the answer, dt [s] apart, the first at dt
    head: width of the trajectory head; dropout: in it
    projection: width of the space in which pictures and prompts are aligned

    Raises:
        ValueError: naming the field, what was expected and what came.
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
    pooled_columns: int = 1

    def __post_init__(self) -> None:
        check("variant", self.variant in [*SIZES], f"one of {', '.join(SIZES)}", repr(self.variant))
        for name, least in LEAST.items():
            value = getattr(self, name)
            whole = isinstance(value, int) and value >= least
            check(name, whole, f"a whole number of {least} or more", value)
        size, dt, dropout = self.image_size, self.dt, self.dropout
        cells = isinstance(size, int) and size % STRIDE == 0 and 1 <= self.cells <= MOST_CELLS
        sizes = f"a multiple of {STRIDE} from {STRIDE} to {MOST_CELLS * STRIDE}"
        check("image_size", cells, sizes, size)
        pooled = self.cells % self.pooled_columns == 0
        check("pooled_columns", pooled, f"a divisor of {self.cells} cells", self.pooled_columns)
        needed = 2 * self.cells**2 // self.pooled_columns + 1 + self.max_tokens
        room = f"at least {needed}, for two pictures of {size} pixels and {self.max_tokens} tokens"
        check("positions", self.positions >= needed, room, self.positions)
        check("dt", isinstance(dt, int | float) and 0 < dt < float("inf"), "a number above 0", dt)
        share = isinstance(dropout, int | float) and 0 <= dropout < 1
        check("dropout", share, "a number from 0 to below 1", dropout)

    @property
    def cells(self) -> int:
        """Along a side of one picture's features, before columns are pooled."""
        return self.image_size // STRIDE

    @property
    def size(self) -> FlorenceSize:
        return SIZES[self.variant]


# transformers is slow to import, and needed only where a network is made.
if TYPE_CHECKING:
    from transformers import Florence2Config, Florence2ForConditionalGeneration

BEGIN, PAD, END = 0, 1, 2
"""Florence-2's own tokens, which a tokenizer trained here shares."""


def florence_config(config: V2XConfig) -> Florence2Config:
    """As `config.json` of the published folders says it."""
    from transformers import BartConfig, Florence2Config
    from transformers.models.florence2.configuration_florence2 import Florence2VisionConfig

    size = config.size
    vision = Florence2VisionConfig(
        depths=size.depths,
        embed_dim=size.embed_dim,
        num_heads=size.num_heads,
        num_groups=size.num_heads,
        window_size=size.window,
        drop_path_rate=size.drop_path,
        projection_dim=size.width,
    )
    text = BartConfig(
        vocab_size=config.vocabulary,
        d_model=size.width,
        encoder_layers=size.layers,
        decoder_layers=size.decoder_layers,
        encoder_attention_heads=size.heads,
        decoder_attention_heads=size.heads,
        encoder_ffn_dim=4 * size.width,
        decoder_ffn_dim=4 * size.width,
        max_position_embeddings=config.positions,
        dropout=size.dropout,
        attention_dropout=size.dropout,
        activation_dropout=size.dropout,
        bos_token_id=BEGIN,
        pad_token_id=PAD,
        eos_token_id=END,
        decoder_start_token_id=END,
        forced_eos_token_id=END,
    )
    # The two configurations of a published folder name the token of a picture; here pictures are
    # put before the prompt, and no token stands for them.
    return Florence2Config(text_config=text, vision_config=vision, image_token_id=PAD)


def new_florence(config: V2XConfig) -> Florence2ForConditionalGeneration:
    """Random weights.

    Those of the published sizes are drawn as `transformers` does, with a spread of 0.02. That is
    for layers a thousand wide: in the tiny one, which has to learn from nothing, they follow the
    layers' widths (Glorot and Bengio, 2010).
    """
    from transformers import Florence2ForConditionalGeneration

    florence = Florence2ForConditionalGeneration(florence_config(config))
    if config.variant == "tiny":
        for module in florence.modules():
            if isinstance(module, nn.Linear | nn.Conv2d):
                nn.init.xavier_uniform_(module.weight)
    return florence
