"""GoalFlow: a car's trajectories, drawn to goals on a raster of what is around it."""

from anchorflow_models.goalflow.config import BevLayout, GoalFlowConfig, ScoreWeights
from anchorflow_models.goalflow.goalflow import GoalFlow

__all__ = ["BevLayout", "GoalFlow", "GoalFlowConfig", "ScoreWeights"]
