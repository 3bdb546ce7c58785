"""A simulated robot that drives to a goal past obstacles that it only knows from its scans.

world, forests, robots,  what there is, and how much room its widest way leaves
world_sources, lidar,
widest_way
local_map,               what the robot knows of it
clearance_grid
mppi, navigation_cost,   how it decides, on its own or helped by anchors
path_following,
ways_left
anchor_sources,          who proposes anchors, and when their answer arrives in simulated time
simulated_time
drive                    the loop
contest, run_log,        worlds and contenders, scored as the BARN challenge does
scoring
"""
