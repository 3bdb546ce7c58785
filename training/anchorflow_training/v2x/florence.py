"""Reads published Florence-2 folders: config.json, the weights and tokenizer.json.

Two layouts are read. In that of `transformers`, which its converter writes, the table of words is
padded to a multiple of 64 rows. Microsoft's, for remote code, has other names of weights and of
settings, and knows 1,024 tokens that its tokenizer.json lacks. `load_pretrained` copies the rows
of the tokenizer's tokens, and as many positions as the network has.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors.torch import load_file
from torch import Tensor

from anchorflow_models.v2x_vlm import V2XVLM
from anchorflow_models.v2x_vlm.config import florence_config
from anchorflow_training.dataset import DatasetError
from anchorflow_training.settings import ConfigError
from anchorflow_training.v2x.text import FILE_NAME, opened, read_tokenizer

if TYPE_CHECKING:
    from transformers import Florence2Config, Florence2ForConditionalGeneration

CONFIG = "config.json"
WEIGHTS = ("model.safetensors", "pytorch_model.bin")
MODEL_TYPES: Mapping[str, tuple[str, ...]] = {
    "": ("florence2",),
    "text_config.": ("bart", "florence2_language", ""),
    "vision_config.": ("florence_vision", "davit", ""),
}
"""Model types of each part of config.json; Microsoft's parts need not name one."""
FEATURES = ["spatial_avg_pool", "temporal_avg_pool"]
"""What the projector puts before the prompt; Microsoft's settings name it."""
MICROSOFT_SETTINGS: Mapping[str, tuple[str, ...]] = {
    "embed_dim": ("dim_embed",),
    "max_position_embeddings": ("image_pos_embed", "max_pos_embeddings"),
    "max_temporal_embeddings": ("visual_temporal_embedding", "max_temporal_embeddings"),
}
"""Where Microsoft's vision_config has what `transformers` names otherwise."""
ROWS = ("vocab_size", "max_position_embeddings")
"""Settings of text_config of which the network may have less."""
FIELDS: Mapping[str, tuple[str, ...]] = {
    "text_config": (
        "d_model",
        "encoder_layers",
        "decoder_layers",
        "encoder_attention_heads",
        "decoder_attention_heads",
        "encoder_ffn_dim",
        "decoder_ffn_dim",
        "activation_function",
        "scale_embedding",
        "bos_token_id",
        "pad_token_id",
        "eos_token_id",
        "decoder_start_token_id",
    ),
    "vision_config": (
        "depths",
        "embed_dim",
        "num_heads",
        "num_groups",
        "window_size",
        "projection_dim",
        "patch_size",
        "patch_stride",
        "patch_padding",
        "patch_prenorm",
        "mlp_ratio",
        "qkv_bias",
        "activation_function",
        "max_position_embeddings",
        "max_temporal_embeddings",
    ),
}
"""What decides the result of the same weights, and must be as in the network."""
LANGUAGE = "model.language_model."
TIED = (
    f"{LANGUAGE}shared.weight",
    f"{LANGUAGE}encoder.embed_tokens.weight",
    f"{LANGUAGE}decoder.embed_tokens.weight",
    "lm_head.weight",
)
"""Names of one table, of which a file holds some."""
TABLES: Mapping[str, tuple[str, int]] = {
    **dict.fromkeys(TIED, (ROWS[0], 0)),
    f"{LANGUAGE}encoder.embed_positions.weight": (ROWS[1], 2),
    f"{LANGUAGE}decoder.embed_positions.weight": (ROWS[1], 2),
}
"""Tables of which the network may have the first rows: the setting, and BART's rows beside."""
SHOWN = 8
"""Names in a message."""
PROJECTION = "image_projection"
"""Microsoft's, [in, out]: transposed."""
LOGITS_BIAS = "language_model.final_logits_bias"
"""Microsoft's, zeros that nothing learns."""
PROJECTOR = "model.multi_modal_projector."
RENAMED = (
    (r"^vision_tower\.(convs\.\d+)\.proj\.", r"vision_tower.\1.conv."),
    (r"\.(conv[12])\.fn\.dw\.", r".\1."),
    (r"\.(?:window|channel)_attn\.norm\.", ".norm1."),
    (r"\.((?:window|channel)_attn)\.fn\.", r".\1."),
    (r"\.ffn\.norm\.", ".norm2."),
    (r"\.ffn\.fn\.net\.", ".ffn."),
    (r"^vision_tower\.", "model.vision_tower."),
    (r"^image_projection$", f"{PROJECTOR}image_projection.weight"),
    (r"^image_pos_embed\.", f"{PROJECTOR}image_position_embed."),
    (r"^(image_proj_norm|visual_temporal_embed)\.", rf"{PROJECTOR}\1."),
    (r"^language_model\.model\.", LANGUAGE),
    (r"^language_model\.lm_head\.", "lm_head."),
)
"""Microsoft's names of weights, as patterns, and what `transformers` has in their place."""


def load_pretrained(model: V2XVLM, folder: Path) -> None:
    """Give a network the weights of a published folder, whose tokenizer it must have.

    Raises `ConfigError` if the folder cannot be read, or does not fit the network.
    """
    theirs, ours = read_config(folder), florence_config(model.config)
    for part, names in FIELDS.items():
        for name in names:
            own, found = (_plain(getattr(getattr(each, part), name)) for each in (ours, theirs))
            if own != found:
                raise _wrong(folder / CONFIG, f"{part}.{name}", own, found)
    for name in ROWS:
        own, found = (getattr(each.text_config, name) for each in (ours, theirs))
        if found < own:
            raise _wrong(folder / CONFIG, f"text_config.{name}", f"{own} or more", found)
    try:
        vocabulary = opened(read_tokenizer(folder)).get_vocab()
    except DatasetError as error:
        raise ConfigError(f"pretrained: {error}") from error
    if vocabulary != opened(model.tokenizer).get_vocab():
        expected = f"the pairs' tokenizer, as of `anchorflow data pairs --tokenizer {folder}`"
        raise _wrong(folder, FILE_NAME, expected, "another")
    _load_weights(model.florence, theirs, folder)


def load_florence(folder: Path) -> Florence2ForConditionalGeneration:
    """The network of a published folder, whole. Raises `ConfigError`."""
    from transformers import Florence2ForConditionalGeneration

    config = read_config(folder)
    florence = Florence2ForConditionalGeneration(config)
    _load_weights(florence, config, folder)
    return florence.eval()


def read_config(folder: Path) -> Florence2Config:
    """The settings of config.json, in the names of `transformers`. Raises `ConfigError`."""
    from transformers import BartConfig, Florence2Config
    from transformers.models.florence2.configuration_florence2 import Florence2VisionConfig

    file = folder / CONFIG
    try:
        found = json.loads(file.read_text())
        text, vision = (dict(found[part]) for part in FIELDS)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"pretrained: {file}: expected the settings of a Florence-2 ({error!r})"
        ) from error
    for part, settings in {"": found, "text_config.": text, "vision_config.": vision}.items():
        kind = settings.get("model_type") or ""
        if kind not in MODEL_TYPES[part]:
            expected = " or ".join(filter(None, MODEL_TYPES[part]))
            raise _wrong(file, f"{part}model_type", expected, repr(kind))
    source = vision.get("image_feature_source", FEATURES)
    if source != FEATURES:
        raise _wrong(file, "vision_config.image_feature_source", FEATURES, source)
    try:
        for name, (first, *within) in MICROSOFT_SETTINGS.items():
            if first in vision:
                vision.setdefault(name, vision[first][within[0]] if within else vision[first])
        bart = {name: text[name] for name in (*FIELDS["text_config"], *ROWS) if name in text}
        davit = {name: vision[name] for name in FIELDS["vision_config"] if name in vision}
        return Florence2Config(
            text_config=BartConfig(**bart), vision_config=Florence2VisionConfig(**davit)
        )
    except Exception as error:  # the library's own validation errors are plain `Exception`s
        raise ConfigError(f"pretrained: {file}: {error}") from error


def _load_weights(
    florence: Florence2ForConditionalGeneration, config: Florence2Config, folder: Path
) -> None:
    """Fill a network, whose tables may be shorter, from a folder of these settings."""
    file, weights = _weights(folder)
    wanted = florence.state_dict()
    for name, (setting, beside) in TABLES.items():
        rows = getattr(config.text_config, setting)
        if name in weights:
            if weights[name].shape[:1] != (rows + beside,):
                expected = f"{rows + beside} rows, by {setting} of {CONFIG}"
                raise _wrong(file, name, expected, [*weights[name].shape])
            weights[name] = weights[name][: len(wanted[name])]
    missing, unexpected = wanted.keys() - weights.keys(), weights.keys() - wanted.keys()
    if missing or unexpected:
        raise ConfigError(
            f"pretrained: {file}: expected the weights of this Florence-2, found it without "
            f"{_listed(missing)}, and with {_listed(unexpected)} beside them"
        )
    for name, value in weights.items():
        if value.shape != wanted[name].shape or not value.is_floating_point():
            expected = f"floating-point numbers {[*wanted[name].shape]}"
            raise _wrong(file, name, expected, f"{value.dtype} {[*value.shape]}")
    florence.load_state_dict(weights)


def _weights(folder: Path) -> tuple[Path, dict[str, Tensor]]:
    """Read the file of weights; its tensors get the names that `transformers` uses."""
    present = [folder / name for name in WEIGHTS if (folder / name).is_file()]
    if not present:
        raise _wrong(folder, "weights", " or ".join(WEIGHTS), "none")
    file = present[0]
    found = _read_tensors(file)
    bias = found.pop(LOGITS_BIAS, None)
    if bias is not None and bias.any():
        raise _wrong(file, LOGITS_BIAS, "zeros", "others")
    if PROJECTION in found:
        found[PROJECTION] = found[PROJECTION].T
    weights = {_renamed(name): value for name, value in found.items()}
    tables = {name: weights[name] for name in TIED if name in weights}
    for name, table in tables.items():
        if not torch.equal(table, tables[next(iter(tables))]):
            raise _wrong(file, name, f"the same table as {next(iter(tables))}", "another")
    weights.update(dict.fromkeys(TIED, next(iter(tables.values()))) if tables else {})
    return file, weights


def _read_tensors(file: Path) -> dict[str, Tensor]:
    try:
        if file.suffix == ".safetensors":
            return load_file(file)
        found = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever the libraries raise of other bytes
        raise ConfigError(
            f"pretrained: {file}: expected weights, found another file or one that is cut short"
        ) from error
    if not isinstance(found, dict) or not all(isinstance(v, Tensor) for v in found.values()):
        raise ConfigError(f"pretrained: {file}: expected tensors by name, found other values")
    return found


def _renamed(name: str) -> str:
    for pattern, ours in RENAMED:
        name = re.sub(pattern, ours, name)
    return name


def _plain(value: Any) -> Any:
    return [*value] if isinstance(value, list | tuple) else value


def _listed(names: set[str]) -> str:
    shown = sorted(names)
    more = f" and {len(shown) - SHOWN} more" if len(shown) > SHOWN else ""
    return (", ".join(shown[:SHOWN]) or "nothing") + more


def _wrong(file: Path, name: str, expected: object, found: object) -> ConfigError:
    return ConfigError(f"pretrained: {file}: {name}: expected {expected}, found {found}")
