"""Layers that any planner may use."""
