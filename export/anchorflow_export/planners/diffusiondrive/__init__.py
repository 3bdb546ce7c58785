"""DiffusionDriveV2: the graphs of a truncated diffusion and of its two scorers."""

from __future__ import annotations

from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners.diffusiondrive.adapter import DiffusionDriveAdapter, start_level
from anchorflow_models.diffusiondrive import DiffusionDriveV2

__all__ = ["DiffusionDriveAdapter", "diffusiondrive_adapter"]


def diffusiondrive_adapter(
    model: DiffusionDriveV2, choices: ExportChoices
) -> DiffusionDriveAdapter:
    """The adapter of a network, whose own configuration says how it is sampled."""
    return DiffusionDriveAdapter(model, start_level(model, choices.noise_scale))
