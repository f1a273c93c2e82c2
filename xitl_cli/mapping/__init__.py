"""Odometry and map of a companion computer: rebuilt from a recording, compared with the truth, saved as files."""
