"""Bridge to another autopilot: pass sensors to it, its outputs to the host, and MAVLink in both directions."""
