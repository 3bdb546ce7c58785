"""Where a run trains and in which precision, through Lightning Fabric."""

from __future__ import annotations

from typing import Any, Literal

import torch
from lightning_fabric import Fabric
from lightning_fabric.plugins import MixedPrecision

from anchorflow_training.config import RunConfig
from anchorflow_training.settings import ConfigError


class MixedProducts(MixedPrecision):
    """Autocast for matrix products; inputs stay in float32.

    Fabric's own plugin rounds a module's inputs too. A bfloat16 position has 8 bits: 3 cm at 8 m.
    """

    def convert_input(self, data: Any) -> Any:
        return data


def make_fabric(config: RunConfig) -> Fabric:
    """The processes of a run; raises `ConfigError` where the machine lacks what is asked for."""
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
