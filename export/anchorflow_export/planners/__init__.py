"""The adapters of the planners, by the name in the registry of planners."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from anchorflow_client.contract import CostMapSpec, SamplerChoice
from anchorflow_export.adapter import ExportChoices, PlannerAdapter
from anchorflow_export.planners.diffusiondrive import diffusiondrive_adapter
from anchorflow_export.planners.flowmp import flowmp_adapter
from anchorflow_export.planners.goalflow import goalflow_adapter
from anchorflow_export.planners.v2x_vlm import v2x_vlm_adapter
from anchorflow_export.planners.wote import wote_adapter
from anchorflow_export.tracing import ExportError
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.entries import OdeEntry, SplineEntry

ADAPTERS: Mapping[str, Callable[[Any, ExportChoices], PlannerAdapter]] = {
    "flowmp": flowmp_adapter,
    "goalflow": goalflow_adapter,
    "wote": wote_adapter,
    "diffusiondrive": diffusiondrive_adapter,
    "v2x_vlm": v2x_vlm_adapter,
}
"""Functions that adapt a network."""

OF_GOALFLOW = ("score", "goal_inputs")
USES: Mapping[str, tuple[str, ...]] = {
    "flowmp": (*(n for n in ExportChoices.__dataclass_fields__ if n not in OF_GOALFLOW), "int8"),
    "goalflow": ("sampler", "noise_scale", *OF_GOALFLOW),
    "diffusiondrive": ("noise_scale",),
}
"""The `ExportChoices`, and those of `quantize_bundle`, that a planner uses; others use none."""


def check_used(planner: str, names: Iterable[str]) -> None:
    """Raise `ExportError` if a planner does not use one of these choices."""
    used = USES.get(planner, ())
    for name in names:
        if name not in used:
            known = ", ".join(used) or "none"
            raise ExportError(
                f"expected choices that a {planner} has a use for ({known}), got {name}"
            )


def choices_of(bundle: Bundle) -> dict[str, Any]:
    """Return the choices that a bundle was made with, by name; limits are those of its data."""
    manifest = bundle.manifest
    told, asked = manifest.training, {spec.name for spec in manifest.request.inputs}
    made: dict[str, Any] = {
        "noise_scale": told.get("noise_scale", 1.0),
        "score": told.get("score", {}),
        "goal_inputs": "goal" in asked,
    }
    if isinstance(manifest.sampler, OdeEntry):
        made["sampler"] = SamplerChoice(manifest.sampler.method, manifest.sampler.schedule)
    if isinstance(finish := manifest.finish, SplineEntry):
        made |= {"refine_steps": finish.steps, "refine_rate": finish.rate}
        made["safety_margin"] = finish.safety_margin
    if isinstance(manifest.conditioning, CostMapSpec):
        made["robot_radius"] = manifest.conditioning.limits.robot_radius
    return {name: value for name, value in made.items() if name in USES.get(manifest.planner, ())}


def adapter_of(planner: str, model: Any, choices: ExportChoices) -> PlannerAdapter:
    """Return the adapter of a planner's network. Raises `ExportError` if the planner has none."""
    if planner not in ADAPTERS:
        raise ExportError(f"planner: expected one of {', '.join(ADAPTERS)}, got {planner!r}")
    return ADAPTERS[planner](model, choices)
