"""Numbers of ArduPilot and MAVLink by name, as data: modes, events, errors, commands, functions, boards."""
