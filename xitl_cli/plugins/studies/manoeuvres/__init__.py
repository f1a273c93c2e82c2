"""Standard manoeuvres of a vessel without an autopilot, and what they measure."""
