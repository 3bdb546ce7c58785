"""Measure planners that drive, on recorded logs and in simulated traffic."""
