"""Weights that seeing begins with: a published ResNet, another planner's perception, a bundle's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_models.torch_graphs import Role
from anchorflow_models.transfuser import FarSight, GroundSight, SweepMotion, TransfuserBackbone
from anchorflow_training.checkpoint import load_checkpoint
from anchorflow_training.settings import ConfigError

BACKBONE = "backbone"
SIGHT = (TransfuserBackbone, GroundSight, SweepMotion, FarSight)
"""The parts by which planners see, under the same names in each."""
FIRST = "embedder.embedder.convolution.weight"  # [stem, colours, 7, 7]


def load_resnet(backbone: TransfuserBackbone, folder: Path) -> None:
    """Begin both networks of a backbone with the weights of a ResNet.

    folder: what `save_pretrained` of a `transformers` ResNet writes, config.json and
        model.safetensors; nothing is downloaded. The LiDAR's first weights are the sum of the
        colours'; an earlier sweep is not heard yet.

    Raises `ConfigError` if there is no ResNet in the folder, or one of another shape.
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


def sight_of(model: nn.Module) -> dict[str, Any]:
    """The parts by which a planner sees, by their names; a backbone is among them."""
    parts = model.named_modules()
    return {name.rpartition(".")[2]: part for name, part in parts if isinstance(part, SIGHT)}


def load_sight(sight: Mapping[str, nn.Module], checkpoint: Path) -> None:
    """Begin with the averaged weights of the same parts in any planner's checkpoint.

    Parts beside the backbone that only one of both planners has stay as they are.

    Raises `CheckpointError` if it cannot be read; `ConfigError` if it has no backbone, or a part of
    another shape.
    """
    average = {f".{name}": value for name, value in load_checkpoint(checkpoint).average.items()}
    for part, module in sight.items():
        within = f".{part}."
        weights = {n.rpartition(within)[2]: value for n, value in average.items() if within in n}
        if not weights and part != BACKBONE:
            continue
        try:
            module.load_state_dict(weights)
        except RuntimeError as error:
            said = f"perception: {checkpoint}: its {part} does not fit: {error}"
            raise ConfigError(said) from error


def _weights(folder: Path) -> dict[str, Any]:
    from transformers import ResNetBackbone

    if not (folder / "config.json").is_file():
        raise ConfigError(f"{folder}: expected a ResNet's config.json and model.safetensors")
    try:
        network = ResNetBackbone.from_pretrained(folder, local_files_only=True)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{folder}: cannot be read as a ResNet ({error})") from error
    return network.state_dict()


def folded_normalisation(model: nn.Module) -> list[nn.BatchNorm2d]:
    """Return the normalisations that a bundle's exporter folded into the convolution before them.

    They change nothing but add their bias, and know no mean and variance.
    """
    parts = [each for each in model.modules() if isinstance(each, nn.BatchNorm2d)]
    return [part for part in parts if _changes_nothing(part)]


def _changes_nothing(part: nn.BatchNorm2d) -> bool:
    mean, variance = part.running_mean, part.running_var
    if mean is None or variance is None:
        return False
    return not mean.any() and bool((variance + part.eps == 1).all())


@torch.no_grad()
def measure_normalisation(model: nn.Module, batches: Iterable[Mapping[str, np.ndarray]]) -> None:
    """Measure the means and variances that folded normalisations lack, as training will use them.

    What the network computes stays the same. batches: inputs of its `encode` by name
    """
    sums: dict[nn.BatchNorm2d, list[Tensor]] = {part: [] for part in folded_normalisation(model)}
    if not sums:
        return

    def measured(part: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        x = inputs[0].transpose(0, 1).flatten(1)
        sums[cast("nn.BatchNorm2d", part)].append(torch.stack([x.mean(1), x.square().mean(1)]))

    hooks = [part.register_forward_pre_hook(measured) for part in sums]
    learning = model.training
    model.eval()
    for batch in batches:
        tensors = {name: torch.from_numpy(each) for name, each in batch.items()}
        Role(model, "encode", outputs=("",)).run(tensors)
    model.train(learning)
    for hook in hooks:
        hook.remove()
    for part, each in sums.items():
        mean, square = torch.stack(each).mean(0)
        variance = (square - mean.square()).clamp(min=part.eps)
        part.bias.add_(mean)
        part.weight.copy_((variance + part.eps).sqrt())
        part.load_state_dict({**part.state_dict(), "running_mean": mean, "running_var": variance})
