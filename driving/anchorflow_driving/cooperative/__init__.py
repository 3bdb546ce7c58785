"""Cooperative recordings: what a car's camera and one on a pole see of the same street.

layout      the folder that DAIR-V2X published, written
painter     pictures of boxes on a plane, by a pinhole camera
crossings   made scenes in which the pole sees who crosses before the car does
"""
