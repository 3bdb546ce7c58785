"""One adapter a planner: its graphs, what its manifest says, and the trials that prove them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from anchorflow_export.adapter import ExportChoices, PlannerAdapter
from anchorflow_export.errors import ExportError
from anchorflow_export.planners.diffusiondrive import diffusiondrive_adapter
from anchorflow_export.planners.flowmp import flowmp_adapter
from anchorflow_export.planners.goalflow import goalflow_adapter
from anchorflow_export.planners.v2x_vlm import v2x_vlm_adapter
from anchorflow_export.planners.wote import wote_adapter

ADAPTERS: Mapping[str, Callable[[Any, ExportChoices], PlannerAdapter]] = {
    "flowmp": flowmp_adapter,
    "goalflow": goalflow_adapter,
    "wote": wote_adapter,
    "diffusiondrive": diffusiondrive_adapter,
    "v2x_vlm": v2x_vlm_adapter,
}
"""By the name in the registry of planners: from a network to its adapter."""

USES: Mapping[str, tuple[str, ...]] = {
    "flowmp": (*ExportChoices.__dataclass_fields__, "int8"),
    "goalflow": ("sampler", "noise_scale"),
    "diffusiondrive": ("noise_scale",),
}
"""Which of the `ExportChoices`, and of `quantize_bundle`, a planner has a use for; one that is not
listed has none for any."""


def check_used(planner: str, names: Iterable[str]) -> None:
    """Raise `ExportError` where a planner has no use for one of these choices."""
    used = USES.get(planner, ())
    for name in names:
        if name not in used:
            known = ", ".join(used) or "none"
            raise ExportError(
                f"expected choices that a {planner} has a use for ({known}), got {name}"
            )


def adapter_of(planner: str, model: Any, choices: ExportChoices) -> PlannerAdapter:
    """The adapter of a planner's network. Raises `ExportError` where the planner has none."""
    if planner not in ADAPTERS:
        raise ExportError(f"planner: expected one of {', '.join(ADAPTERS)}, got {planner!r}")
    return ADAPTERS[planner](model, choices)
