"""A controller for robots that takes anchors: MPPI in numpy and numba.

robot = Robot(kind="differential", v_max=1.0, a_max=1.5, omega_max=2.0, radius=0.3)
controller = MppiController(robot, tick_s=0.05)
while driving:
    command = controller.command(state, cost_map=cost_map, goal=goal, anchors=plan)
    base.drive(*command.u)
"""

from anchorflow_control.config import MppiConfig as MppiConfig
from anchorflow_control.controller import Command as Command, MppiController as MppiController
from anchorflow_control.robot import Robot as Robot
