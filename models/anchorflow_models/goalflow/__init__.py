"""GoalFlow: a car's trajectories, drawn to goals on what a raster, or sensors, show around it."""

from anchorflow_models.goalflow.config import (
    BevLayout as BevLayout,
    GoalFlowConfig as GoalFlowConfig,
    ScoreWeights as ScoreWeights,
)
from anchorflow_models.goalflow.goalflow import GoalFlow as GoalFlow
from anchorflow_models.goalflow.sensors import (
    SensorGoalFlow as SensorGoalFlow,
    create_goalflow as create_goalflow,
)
