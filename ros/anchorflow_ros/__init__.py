"""AnchorFlow as a ROS 2 node: cost map, odometry and goal in, velocity commands out.

frames      poses in the plane, and transforms
odometry    the robot's state from nav_msgs/Odometry
maps        grids, their updates, and the cost map of a plan
inputs      goal, footprint, speed limit and tracks

These need numpy alone; the modules beside them need `rclpy`, from a robot's own ROS or by
`pip install 'anchorflow[ros]'`.
"""
