"""Fixed structures and drifting bodies in the river, and their intersections with rays and hulls."""
