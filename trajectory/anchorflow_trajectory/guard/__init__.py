"""The guard of driving plans: whether a car may follow them, and a stop where none is safe.

motion         plans on a fine grid of times, with a bound on what lies between; who can drive them
faults         the compiled test: road, boxes at constant velocity, occupancy by time
raster_boxes   boxes and velocities in rasters of occupancy
stops          stops along the paths of plans
"""
