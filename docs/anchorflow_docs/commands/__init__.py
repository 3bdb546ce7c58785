"""Find the commands that the documentation prints, and run them as printed."""
