"""GoalFlow: a flow to goals, on a raster of what is around a car."""

from __future__ import annotations

from copy import deepcopy

from anchorflow_client.contract import OdeSpec, uniform_schedule
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners.goalflow.adapter import GoalFlowAdapter
from anchorflow_models.goalflow import GoalFlow

__all__ = ["GoalFlowAdapter", "goalflow_adapter"]

DEFAULT_SAMPLER = OdeSpec("euler", uniform_schedule(1))


def goalflow_adapter(model: GoalFlow, choices: ExportChoices) -> GoalFlowAdapter:
    """The adapter of a trained network, whose noise gets the spread that is asked for."""
    model = deepcopy(model)
    model.noise_scale = choices.noise_scale
    return GoalFlowAdapter(model=model, sampler=choices.sampler.over(DEFAULT_SAMPLER))
