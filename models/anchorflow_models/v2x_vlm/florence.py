"""The native Florence-2 classes of `transformers`, made of a configuration: no remote code."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import nn

from anchorflow_models.v2x_vlm.config import V2XConfig

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
