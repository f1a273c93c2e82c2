"""MAVLink frames as tables: telemetry logs, and the raw frames of a recording."""
