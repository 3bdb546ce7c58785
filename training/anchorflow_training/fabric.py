"""Devices and precision of a run through Lightning Fabric, and the check for divergence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import torch
from lightning_fabric import Fabric
from lightning_fabric.plugins import MixedPrecision
from torch import Tensor

from anchorflow_client.errors import AnchorFlowError
from anchorflow_training.config import RunConfig
from anchorflow_training.settings import ConfigError


class MixedProducts(MixedPrecision):
    """Autocast for matrix products; inputs stay in float32.

    Fabric's own plugin rounds a module's inputs too. A bfloat16 position has 8 bits: 3 cm at 8 m.
    """

    def convert_input(self, data: Any) -> Any:
        return data


def make_fabric(config: RunConfig) -> Fabric:
    """Return the processes of a run; raise `ConfigError` if the machine lacks a device or
    precision.
    """
    accelerator, precision = _accelerator(config), config.precision
    if precision == "auto":
        precision = _mixed() if accelerator == "cuda" else "float32"
    if precision == "float16" and accelerator == "cpu":
        raise ConfigError("precision: float16 needs a GPU; a CPU has bfloat16")
    names: dict[str, Literal["bf16-mixed", "16-mixed"]] = {
        "bfloat16": "bf16-mixed",
        "float16": "16-mixed",
    }
    plugin = MixedProducts(names[precision], accelerator) if precision in names else None
    # A loss need not ask all weights: a stage learns some of them, a scene has no roadside.
    strategy = "ddp_find_unused_parameters_true" if config.devices > 1 else "auto"
    return Fabric(
        accelerator=accelerator, devices=config.devices, strategy=strategy, plugins=plugin
    )


def _accelerator(config: RunConfig) -> Literal["cpu", "cuda"]:
    available = torch.cuda.is_available()
    if config.accelerator == "auto":
        return "cuda" if available else "cpu"
    if config.accelerator == "cuda" and not available:
        raise ConfigError("accelerator: expected a CUDA GPU, found none")
    return config.accelerator


def _mixed() -> Literal["bfloat16", "float16"]:
    return "bfloat16" if torch.cuda.is_bf16_supported(including_emulation=False) else "float16"


class DivergenceError(AnchorFlowError):
    """A term of the loss is not finite; the message names the step and the term."""


def check_finite(
    terms: Mapping[str, Tensor], *, step: int, fabric: Fabric, checkpoint: Path
) -> None:
    """Raise `DivergenceError` naming every term that is not finite, in all processes alike.

    terms: scalars by name; step: the optimiser step that they would bring about
    checkpoint: what a message may send the reader to
    """
    values = torch.stack([value.detach().float().to(fabric.device) for value in terms.values()])
    # All processes stop, or none: one that is left alone would wait for the others. A sum with a
    # term that is not finite is not finite either.
    shared = torch.as_tensor(fabric.all_reduce(values, reduce_op="sum")).tolist()
    named = zip(terms, shared, strict=True)
    wrong = [f"{name} {value:g}" for name, value in named if not math.isfinite(value)]
    if wrong:
        kept = f"{checkpoint} is as it was" if checkpoint.exists() else "there is no checkpoint yet"
        raise DivergenceError(
            f"step {step}: expected finite loss terms, got {', '.join(wrong)}; the weights are "
            f"untouched and {kept}"
        )
