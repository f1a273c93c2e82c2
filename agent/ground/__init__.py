"""Ground stations: several at once, over UDP and TCP, on one autopilot."""
