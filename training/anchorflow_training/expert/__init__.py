"""The expert: grid paths on several sides of the obstacles, polished by the service's descent."""

from anchorflow_training.expert.solve import ExpertConfig, Solution, solve

__all__ = ["ExpertConfig", "Solution", "solve"]
