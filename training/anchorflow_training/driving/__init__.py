"""Planners that drive: windows of driving logs, and how each planner learns from them."""
