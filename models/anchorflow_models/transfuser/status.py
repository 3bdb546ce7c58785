"""The ego status that is told beside camera and LiDAR."""

STATUS = 8
"""Numbers: the command as one of four, velocity x and y, acceleration x and y."""
STATUS_UNITS = (1.0,) * 4 + (10.0,) * 2 + (3.0,) * 2
"""What each is usually as large as: m/s and m/s²."""
MOTION = slice(4, 8)
"""Of the status, velocity and acceleration."""
