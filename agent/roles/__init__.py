"""What a node can be, and what the embedded autopilot serves beside the host."""
