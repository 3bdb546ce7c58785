"""Solvers of a flow: methods as data, schedules of flow time, and the loop in numpy."""
