"""Published Florence-2 weights, from a folder on this machine; nothing is fetched."""

from __future__ import annotations

import json
from pathlib import Path

from anchorflow_models.v2x_vlm import V2XVLM
from anchorflow_models.v2x_vlm.florence import florence_config
from anchorflow_training.settings import ConfigError

TEXT_FIELDS = (
    "vocab_size",
    "d_model",
    "encoder_layers",
    "decoder_layers",
    "encoder_attention_heads",
    "max_position_embeddings",
)
VISION_FIELDS = ("depths", "embed_dim", "num_heads", "window_size", "projection_dim")


def load_pretrained(model: V2XVLM, folder: Path) -> None:
    """Give a network the weights of a folder that `save_pretrained` wrote.

    Raises:
        ConfigError: the folder cannot be read, or is of another shape than the network.
    """
    from transformers import Florence2ForConditionalGeneration

    try:
        found = json.loads((folder / "config.json").read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"pretrained: {folder / 'config.json'}: {error}") from error
    wanted = florence_config(model.config).to_dict()
    for part, fields in (("text_config", TEXT_FIELDS), ("vision_config", VISION_FIELDS)):
        for name in fields:
            own, given = wanted[part][name], found.get(part, {}).get(name)
            if given is not None and given != (list(own) if isinstance(own, tuple) else own):
                raise ConfigError(
                    f"pretrained: {folder / 'config.json'}: {part}.{name}: expected {own}, as the "
                    f"model's configuration has it, found {given}"
                )
    try:
        other = Florence2ForConditionalGeneration.from_pretrained(folder, local_files_only=True)
        model.florence.load_state_dict(other.state_dict())
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(f"pretrained: {folder}: {error}") from error
