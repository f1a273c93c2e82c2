"""Clocks, periodic tasks with deadlines, and the relation between the clocks of two machines."""
