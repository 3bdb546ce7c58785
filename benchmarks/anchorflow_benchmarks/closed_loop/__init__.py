"""A simulated robot that drives to a goal past obstacles that it only knows from its scans.

world, forests, robots,  what there is
world_sources, lidar
local_map                what the robot knows of it
mppi, navigation_cost    how it decides, on its own or helped by anchors
anchor_sources,          who proposes anchors, and when their answer arrives in simulated time
simulated_time
drive                    the loop
contest, scoring         worlds and contenders, scored as the BARN challenge does
"""
