"""Weights that a backbone begins with: a ResNet of ImageNet, or what another planner learnt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torch.nn import functional as F

from anchorflow_models.transfuser import TransfuserBackbone
from anchorflow_training.checkpoint import load_checkpoint
from anchorflow_training.settings import ConfigError

BACKBONE = "backbone."  # in the names of the weights of every planner that has one
FIRST = "embedder.embedder.convolution.weight"  # [stem, colours, 7, 7]


def load_resnet(backbone: TransfuserBackbone, folder: Path) -> None:
    """Begin both networks of a backbone with the weights of a ResNet.

    folder: what `save_pretrained` of a `transformers` ResNet writes, config.json and
        model.safetensors; nothing is downloaded. The LiDAR's first weights are the sum of the
        colours'; an earlier sweep is not heard yet.

    Raises:
        ConfigError: there is no ResNet in the folder, or one of another shape.
    """
    weights = _weights(folder)
    earlier = int(backbone.config.lidar_before)
    first = F.pad(weights[FIRST].sum(1, keepdim=True), (0, 0, 0, 0, 0, earlier))
    grey = {**weights, FIRST: first}
    try:
        backbone.image.load_state_dict(weights)
        backbone.lidar.load_state_dict(grey)
    except RuntimeError as error:
        raise ConfigError(f"{folder}: its ResNet does not fit the backbone: {error}") from error


def load_backbone(backbone: TransfuserBackbone, checkpoint: Path) -> None:
    """Begin with the averaged weights of the backbone of any planner's checkpoint.

    Raises:
        CheckpointError: it cannot be read.
        ConfigError: it has no backbone, or one of another shape.
    """
    average = load_checkpoint(checkpoint).average
    weights = {
        name.partition(BACKBONE)[2]: value for name, value in average.items() if BACKBONE in name
    }
    try:
        backbone.load_state_dict(weights)
    except RuntimeError as error:
        raise ConfigError(f"backbone: {checkpoint}: does not fit: {error}") from error


def _weights(folder: Path) -> dict[str, Any]:
    from transformers import ResNetBackbone

    if not (folder / "config.json").is_file():
        raise ConfigError(f"{folder}: expected a ResNet's config.json and model.safetensors")
    try:
        network = ResNetBackbone.from_pretrained(folder, local_files_only=True)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{folder}: cannot be read as a ResNet ({error})") from error
    return network.state_dict()
