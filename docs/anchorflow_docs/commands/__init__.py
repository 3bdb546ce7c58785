"""The commands that the documentation prints: found, and run as printed."""
