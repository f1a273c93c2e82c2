"""Odometry and map of a companion computer: made anew from a recording, measured against the truth, kept as files."""
