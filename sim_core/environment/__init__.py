"""The surroundings of the vessels: water, current, waves, wind. Null objects represent absent ones."""
