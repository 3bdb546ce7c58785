"""Driving planners on recorded logs."""
