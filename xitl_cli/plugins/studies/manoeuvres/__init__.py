"""Standard manoeuvres of a vessel without an autopilot, and their measures."""
