"""The expert: tries along every route of a scene, polished by the service's descent."""

from anchorflow_training.expert.solve import ExpertConfig, Solution, chosen_by_route, solve

__all__ = ["ExpertConfig", "Solution", "chosen_by_route", "solve"]
