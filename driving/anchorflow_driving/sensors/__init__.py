"""What a planner's sensors would tell of a window, drawn from its log: simulated sensors."""
