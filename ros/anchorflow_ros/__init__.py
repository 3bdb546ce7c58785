"""AnchorFlow as a ROS 2 node: cost map, odometry and goal in, velocity commands out.

frames      poses in the plane, and transforms
odometry    the robot's state from nav_msgs/Odometry
maps        grids, their updates, and the cost map of a plan
inputs      goal, footprint, speed limit and tracks
scene       the newest of all these, or why there is none
driver      the decision at each tick: planner, controller, braking
parameters  the table of the node's parameters
outputs     plans, commands and faults as messages
node        the lifecycle node; `simulator` is a robot for it

`outputs`, `node` and `simulator` need `rclpy` and ROS's messages, from a robot's own ROS or by
the extra `[ros]`; the others need numpy and numba.
"""
