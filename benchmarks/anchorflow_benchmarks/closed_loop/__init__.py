"""A simulated robot that drives to a goal past obstacles that it only knows from its scans."""
