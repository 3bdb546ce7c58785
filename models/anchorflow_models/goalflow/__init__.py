"""GoalFlow: a car's trajectories, drawn to goals on a raster of what is around it."""

from anchorflow_models.goalflow.config import (
    BevLayout as BevLayout,
    GoalFlowConfig as GoalFlowConfig,
    ScoreWeights as ScoreWeights,
)
from anchorflow_models.goalflow.goalflow import GoalFlow as GoalFlow
