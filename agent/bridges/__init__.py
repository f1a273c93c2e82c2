"""Another autopilot behind the agent: the host's sensors in, its outputs back, its MAVLink passed on both ways."""
