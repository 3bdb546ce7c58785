"""Simulated sensors: a planner's inputs, drawn from a window of a log."""
