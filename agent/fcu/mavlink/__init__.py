"""MAVLink of the embedded autopilot: a hub that all stations share, a channel for each station, streams, commands,
plans.
"""
