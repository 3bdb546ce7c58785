"""Driving: logs, what a planner may see of them, the PDM score, rule-based drivers."""
