"""The embedded autopilot: sensing (LS), control (LC) and actuation (LA), its parameters, missions and MAVLink services."""
