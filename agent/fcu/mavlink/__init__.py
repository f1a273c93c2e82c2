"""The autopilot toward those who talk to it: one vehicle, services and telemetry for each of them."""
