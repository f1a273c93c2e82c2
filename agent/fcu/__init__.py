"""The embedded autopilot: sensing (LS), control (LC), actuation (LA), parameters, missions, MAVLink services."""
