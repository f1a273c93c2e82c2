"""MAVLink of the embedded autopilot: a hub that all stations share, a channel for each, streams, commands, plans."""
