"""Trajectory mathematics in numpy and numba: splines, clearance, routes, cost, descent.

The service refines anchors with it and the training's expert is built on it, so both mean the same
by "clearance", "cost" and "within the limits".
"""
