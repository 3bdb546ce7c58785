"""Random scenes: a map, a robot's state and a goal, in the families that robots meet."""

from anchorflow_training.scenes.scene import FamilyScene, RobotRanges, SceneError, draw_scene

__all__ = ["FamilyScene", "RobotRanges", "SceneError", "draw_scene"]
