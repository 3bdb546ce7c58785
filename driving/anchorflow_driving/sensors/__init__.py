"""A planner's inputs of a window: from recorded sensors, or simulated ones drawn from the log."""
