"""FlowMP: the graphs of a flow over position, velocity and acceleration, on a cost map."""

from __future__ import annotations

from copy import deepcopy

from anchorflow_client.contract import OdeSpec, uniform_schedule
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners.flowmp.adapter import FlowMPAdapter
from anchorflow_models.flowmp import L2SafetyCFM
from anchorflow_service.bundle.conditioning import CostMapEntry, LimitsEntry
from anchorflow_service.bundle.manifest import SplineEntry

__all__ = ["FlowMPAdapter", "flowmp_adapter"]

DEFAULT_SAMPLER = OdeSpec("rk4", uniform_schedule(8))


def flowmp_adapter(model: L2SafetyCFM, choices: ExportChoices) -> FlowMPAdapter:
    """The adapter of a copy of a trained network, whose noise gets the spread that is asked for."""
    config, asked = model.config, choices.limits
    model = deepcopy(model)
    model.prior.widen(choices.noise_scale)
    limits = LimitsEntry(
        horizon_s=asked.horizon_s,
        v_max=asked.v_max,
        a_max=asked.a_max,
        robot_radius=choices.robot_radius,
    )
    return FlowMPAdapter(
        model=model,
        T=config.num_steps,
        D=config.dim,
        conditioning=CostMapEntry(
            channels=config.map_channels,
            H=config.map_size,
            W=config.map_size,
            limits=limits,
            ranges=dict(choices.ranges),  # pyright: ignore[reportArgumentType] - it checks names
        ),
        sampler=choices.sampler.over(DEFAULT_SAMPLER),
        finish=SplineEntry(
            smooth=True,
            project=True,
            safety_margin=choices.safety_margin,
            guidance=0.0,
            steps=choices.refine_steps,
            rate=choices.refine_rate,
            num_control_points=config.num_control_points,
            degree=config.degree,
        ),
    )
