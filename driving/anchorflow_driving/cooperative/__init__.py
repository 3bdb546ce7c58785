"""Cooperative recordings: pictures of a car's camera and of a roadside camera.

layout      writes recordings in DAIR-V2X's layout
painter     draws boxes on a plane by a pinhole camera
crossings   synthetic scenes in which only the roadside camera sees the crossing car
"""
