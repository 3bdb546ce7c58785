"""The cost of a trajectory and the fields of the map that it reads."""
